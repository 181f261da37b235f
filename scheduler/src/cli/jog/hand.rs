//! A robot that is moved by hand: one session, with leases and stops as in a mission.

use std::collections::{BTreeMap, BTreeSet};

use downbeat_scripts::{Act, Finding, Fleet, FleetRobot, plan_jog};
use urrcp::{DeviceId, RequestId, Server, Span, Timestamp};

use super::TICK;
use super::sliders::Slider;
use crate::calibrate::{DialogueError, RobotDialogue};
use crate::link::Endpoint;
use crate::server_clock::ServerClock;
use crate::session::Session;

/// Why a robot cannot be moved by hand.
#[derive(Debug, thiserror::Error)]
pub(super) enum JogError {
    /// The robot cannot be connected.
    #[error("{0}")]
    Setup(String),
    /// The robot does not answer, refuses a request, or is not the expected robot.
    #[error(transparent)]
    Dialogue(#[from] DialogueError),
    /// No movement to these positions is possible.
    #[error("{}", reason(.0))]
    Plan(Vec<Finding>),
    /// The position of the contained device is unknown.
    #[error(
        "the robot does not report the position of `{0}`; give the device a `default_value` if it always begins there"
    )]
    Unknown(DeviceId),
}

impl JogError {
    /// Whether the robot can still be moved.
    pub(super) const fn is_passing(&self) -> bool {
        matches!(
            self,
            Self::Plan(_)
                | Self::Unknown(_)
                | Self::Dialogue(
                    DialogueError::Refused(_) | DialogueError::Failed { .. } | DialogueError::Different(_)
                )
        )
    }
}

fn reason(findings: &[Finding]) -> String {
    let Some(first) = findings.first() else { return "the movement is not possible".to_owned() };
    let hint = first.hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default();
    format!("{}{hint}", first.message)
}

/// Time from the first command of a movement to its start, so that all commands arrive before it.
const LEAD: Span = Span::from_millis(200);
/// Time for which a robot may report after the end of a movement that the movement failed.
const AFTER: Span = Span::from_millis(100);

/// A robot that is reserved and can be moved.
pub(super) struct Hand<'a> {
    fleet: &'a Fleet,
    robot: &'a FleetRobot,
    talk: RobotDialogue,
    /// The devices that were moved, and are not ordered to stay yet.
    moved: BTreeSet<DeviceId>,
}

/// A movement that the robot has accepted.
pub(super) struct Movement {
    until: Timestamp<Server>,
    requests: Vec<Requested>,
}

struct Requested {
    device: DeviceId,
    request: Option<RequestId>,
}

impl<'a> Hand<'a> {
    pub(super) async fn begin(
        fleet: &'a Fleet,
        robot: &'a FleetRobot,
        endpoint: Endpoint,
        session: Session,
        patience: Span,
    ) -> Result<Self, JogError> {
        let clock = ServerClock::anchored(Span::ZERO);
        let talk = RobotDialogue::begin(robot, endpoint, clock, session, patience).await?;
        Ok(Self { fleet, robot, talk, moved: BTreeSet::new() })
    }

    /// Renews the leases of the robot, and asks where its devices are.
    pub(super) async fn look(&mut self, sliders: &mut [Slider]) -> Result<(), JogError> {
        self.talk.ping().await?;
        let devices: Vec<DeviceId> = sliders.iter().map(|slider| slider.device.clone()).collect();
        let known = self.talk.positions(&devices).await?;
        for slider in sliders {
            slider.at = known.get(&slider.device).copied().or(slider.at);
            let Some(sensor) = &slider.sensor else { continue };
            slider.reading = match self.talk.read(sensor).await {
                Ok(read) => Some(read.value),
                // A sensor that is busy, or not ready yet.
                Err(DialogueError::Refused(_)) => None,
                Err(error) => return Err(error.into()),
            };
        }
        Ok(())
    }

    /// Plans a movement of all devices with a target, and starts it. `None` if all are there already.
    pub(super) async fn start(&mut self, sliders: &[Slider]) -> Result<Option<Movement>, JogError> {
        let (mut from, mut to) = (BTreeMap::new(), BTreeMap::new());
        for slider in sliders {
            from.extend(slider.at.map(|at| (slider.device.clone(), at)));
            let Some(target) = slider.target.filter(|target| Some(*target) != slider.at) else { continue };
            if slider.at.is_none() {
                return Err(JogError::Unknown(slider.device.clone()));
            }
            if !self.talk.is_as_described(&slider.device) {
                return Err(DialogueError::Different(slider.device.clone()).into());
            }
            to.insert(slider.device.clone(), target);
        }
        let act = plan_jog(self.fleet, &self.robot.id, &from, &to).map_err(JogError::Plan)?;
        match act {
            Some(act) => self.send(act).await.map(Some),
            None => Ok(None),
        }
    }

    async fn send(&mut self, act: Act) -> Result<Movement, JogError> {
        let begin = self.talk.now() + LEAD;
        let mut movement = Movement { until: begin, requests: Vec::new() };
        for script in act.plan.robots.into_iter().flat_map(|robot| robot.scripts) {
            let (device, lasts) = (script.device.clone(), script.duration());
            let lead = begin + script.start.span() - self.talk.now();
            self.moved.insert(device.clone());
            let (start, request) = self.talk.command(&device, script.script, lead).await?;
            movement.until = movement.until.max(start + lasts + AFTER);
            movement.requests.push(Requested { device, request });
        }
        Ok(movement)
    }

    /// Returns whether a movement has ended.
    ///
    /// # Errors
    /// Returns [`DialogueError::Failed`] if the robot reports that it failed.
    pub(super) fn has_ended(&mut self, movement: &Movement) -> Result<bool, JogError> {
        for Requested { device, request } in &movement.requests {
            self.talk.check(device, request.as_ref())?;
        }
        Ok(self.talk.now() >= movement.until)
    }

    /// Moves devices to `targets`, and reads the positions back.
    pub(super) async fn bring(
        &mut self,
        sliders: &mut [Slider],
        targets: &BTreeMap<DeviceId, f64>,
    ) -> Result<(), JogError> {
        self.look(sliders).await?;
        for slider in sliders.iter_mut() {
            slider.target = targets.get(&slider.device).copied();
        }
        let Some(movement) = self.start(sliders).await? else { return Ok(()) };
        while !self.has_ended(&movement)? {
            tokio::time::sleep(TICK).await;
            self.talk.ping().await?;
        }
        self.look(sliders).await
    }

    /// Orders all devices that were moved to stay where they are.
    ///
    /// # Errors
    /// Returns the first error. The devices may then not be at rest; the next call orders them again.
    pub(super) async fn hold(&mut self) -> Result<(), JogError> {
        let mut held = Ok(());
        for device in self.moved.clone() {
            match self.talk.hold(&device).await {
                Ok(()) => drop(self.moved.remove(&device)),
                Err(error) => held = held.and(Err(error.into())),
            }
        }
        held
    }
}
