//! Scenarios of one act for robots with one device, which are sufficient for most tests.

use std::time::Duration;

use crate::{Robot, Stage, Via};

/// Maximum time until a robot starts to play.
pub const SOON: Duration = Duration::from_secs(20);

/// A scenario of one act in which every robot is set to 1, 2, 3, and so on.
pub struct Play {
    pub steps: u32,
    pub every_ms: u32,
    /// Maximum number of steps of one script.
    pub script: u32,
    pub queue: u32,
    pub running: &'static str,
    pub on_failure: &'static str,
    pub tolerance: &'static str,
}

/// A scenario of twelve seconds in a single script, under a lease of one second.
pub const LONG: Play = Play {
    steps: 120,
    every_ms: 100,
    script: 200,
    queue: 1,
    running: "1s",
    on_failure: "stop",
    tolerance: "1s",
};
/// A scenario of nearly five seconds in three scripts of eight steps each.
pub const CHAIN: Play = Play { steps: 24, every_ms: 200, script: 8, queue: 2, running: "2s", ..LONG };
pub const SHORT: Play = Play { steps: 4, every_ms: 100, ..LONG };

impl Play {
    pub fn stage(&self, vias: &[Via]) -> Stage {
        self.set_up(Stage::new(), vias)
    }

    /// Returns a stage with a robot per element of `vias`. The robots accept only TLS.
    pub fn stage_with_keys(&self, vias: &[Via]) -> Stage {
        self.set_up(Stage::with_keys(), vias)
    }

    fn set_up(&self, mut stage: Stage, vias: &[Via]) -> Stage {
        let Self { steps, every_ms, script, queue, running, on_failure, tolerance } = self;
        let keyframe = |step: u32| format!("{{at: {}ms, to: {}}}", step * every_ms, step + 1);
        let track = (0..*steps).map(keyframe).collect::<Vec<_>>().join(", ");
        stage.file("robot.yaml", crate::one_device(*queue, 200, *script));
        stage.file(
            "play.yaml",
            format!(
                "scenario: play
start_tolerance: {tolerance}
on_failure: {on_failure}
stop_condition: {{running: {running}}}
cues:
  - {{at: 0s, robots: all, tracks: {{d: [{track}]}}}}
"
            ),
        );
        for via in vias {
            stage.robot("robot.yaml", *via);
        }
        stage
    }

    #[track_caller]
    pub fn was_played_by(&self, robot: &Robot) {
        let planned: Vec<f64> = (1..=self.steps).map(f64::from).collect();
        assert_eq!(robot.values("d"), planned, "{}", robot.id);
    }
}
