//! Finds scripts of a mission that several robots at one place (their common key prefix) of a Zenoh network receive. Such a script is
//! published at this place once, for all its receivers. The robots that receive the same script are its audience.

use std::collections::HashMap;
use std::sync::Arc;

use urrcp::{Command, ContentHash, RobotId, Script};

use super::Endpoint;
use downbeat_mission::{Mission, RobotIndex};

/// Minimum number of steps of a published script. Shorter scripts are written to each robot, because publishing would cost more than it
/// saves.
const STEPS_MIN: usize = 16;
/// Maximum number of audiences (sets of robots that receive the same script) to which one robot belongs. Scripts for other audiences are
/// written to the robot directly.
const AUDIENCES_MAX: usize = 32;

/// The id of a Zenoh session, and a place (a key prefix that robots share) in its network.
pub(super) type Place = (String, String);

/// The scripts that one robot shares with other robots at the same place of a Zenoh network.
#[derive(Clone, Debug, Default)]
pub(crate) struct SharedScripts {
    /// For the hash of each shared script at the robot's place: the number of its audience, the robots that receive it.
    audience_of: Arc<HashMap<ContentHash, u32>>,
    /// The numbers of the audiences (sets of robots that receive the same script) to which the robot belongs.
    own: Vec<u32>,
}

impl SharedScripts {
    /// Finds the shared scripts of each robot of a mission. Returns them in the order of the endpoints.
    pub(crate) fn of(mission: &Mission, endpoints: &[Endpoint]) -> Vec<Self> {
        let ids = (0..endpoints.len()).map(|robot| (mission.robot_id(RobotIndex::new(robot)), robot));
        let robots: HashMap<&RobotId, usize> = ids.collect();
        let mut places: HashMap<Place, Vec<(usize, &Script)>> = HashMap::new();
        for plan in mission.choreography().acts.iter().flat_map(|act| &act.plan.robots) {
            let Some(robot) = robots.get(&plan.robot) else { continue };
            let Some(place) = endpoints[*robot].place() else { continue };
            let scripts = plan.scripts.iter().map(|script| (*robot, &script.script));
            places.entry(place).or_default().extend(scripts.filter(|(_, script)| is_long(script)));
        }
        let mut all = vec![Self::default(); endpoints.len()];
        for sent in places.into_values() {
            for (robot, shared) in in_one_place(sent) {
                all[robot] = shared;
            }
        }
        all
    }

    pub(crate) fn audiences(&self) -> &[u32] {
        &self.own
    }

    /// Returns the number of the script's audience (the robots that receive it); `None` if the robot does not belong to it.
    pub(crate) fn audience(&self, script: &Script) -> Option<u32> {
        if self.own.is_empty() || !is_long(script) {
            return None;
        }
        self.audience_of.get(&hash_of(script)).copied().filter(|audience| self.own.contains(audience))
    }
}

/// Finds the scripts that several robots at one place receive. Each element of `sent` is a robot's index and one of its scripts.
fn in_one_place(mut sent: Vec<(usize, &Script)>) -> Vec<(usize, SharedScripts)> {
    sent.sort_by_key(|(robot, _)| *robot);
    let mut sets = Sets::default();
    let mut set_of: HashMap<ContentHash, usize> = HashMap::new();
    for (robot, script) in &sent {
        let set = set_of.entry(hash_of(script)).or_default();
        *set = sets.with(*set, *robot);
    }
    // The same set of robots has the same number for all scripts.
    let shared = set_of.into_iter().filter(|(_, set)| sets.count(*set) > 1);
    let audience_of: HashMap<_, _> =
        shared.filter_map(|(hash, set)| Some((hash, u32::try_from(set).ok()?))).collect();
    let audience_of = Arc::new(audience_of);
    let mut all: Vec<(usize, SharedScripts)> = Vec::new();
    for (robot, script) in sent {
        let Some(audience) = audience_of.get(&hash_of(script)) else { continue };
        if all.last().is_none_or(|(last, _)| *last != robot) {
            all.push((robot, SharedScripts { audience_of: Arc::clone(&audience_of), own: Vec::new() }));
        }
        let Some((_, SharedScripts { own, .. })) = all.last_mut() else { continue };
        if own.len() < AUDIENCES_MAX && !own.contains(audience) {
            own.push(*audience);
        }
    }
    all
}

/// Numbered sets of robots. Number 0 is the empty set. Robots must be added in ascending order of their index.
#[derive(Default)]
struct Sets {
    /// The last robot and the size of each set except the empty one.
    known: Vec<(usize, usize)>,
    /// Maps a set's number and an additional robot to the number of the set with that robot added.
    larger: HashMap<(usize, usize), usize>,
}

impl Sets {
    fn with(&mut self, set: usize, robot: usize) -> usize {
        let (last, count) = self.last_and_count(set);
        if last == Some(robot) {
            return set;
        }
        *self.larger.entry((set, robot)).or_insert_with(|| {
            self.known.push((robot, count + 1));
            self.known.len()
        })
    }

    fn count(&self, set: usize) -> usize {
        self.last_and_count(set).1
    }

    fn last_and_count(&self, set: usize) -> (Option<usize>, usize) {
        let known = set.checked_sub(1).and_then(|index| self.known.get(index));
        known.map_or((None, 0), |(last, count)| (Some(*last), *count))
    }
}

fn is_long(script: &Script) -> bool {
    script.steps().len() >= STEPS_MIN
}

/// Returns a script's hash. Later calls are cheap, because scripts cache their hash.
fn hash_of(script: &Script) -> ContentHash {
    Command::Script(script.clone()).content_hash()
}

#[cfg(test)]
mod tests {
    use urrcp::{ControlType, Millis, Setpoint, Step};

    use super::*;

    fn script(value: f64, steps: usize) -> Script {
        let step = |_| Step {
            offset: Millis::new(0.0).unwrap(),
            setpoint: Setpoint::new(ControlType::Position, value),
            stop_condition: None,
        };
        Script::new((0..steps).map(step).collect()).unwrap()
    }

    /// Returns the index of each robot with shared scripts, and its audience for each script in `of`.
    fn audiences(sent: &[(usize, &Script)], of: &[&Script]) -> Vec<(usize, Vec<Option<u32>>)> {
        let shared = in_one_place(sent.to_vec());
        let row = |shared: &SharedScripts| of.iter().map(|script| shared.audience(script)).collect();
        shared.iter().map(|(robot, shared)| (*robot, row(shared))).collect()
    }

    #[test]
    fn scripts_are_shared_only_if_several_robots_have_them() {
        let [all, pair, own] = [1.0, 2.0, 3.0].map(|value| script(value, STEPS_MIN));
        // The list contains duplicates for one robot and is not sorted.
        let sent = [(2, &all), (0, &all), (0, &pair), (1, &all), (1, &pair), (0, &own), (0, &own)];
        let found = audiences(&sent, &[&all, &pair, &own]);
        let [(0, first), (1, second), (2, third)] = found.as_slice() else { panic!("{found:?}") };
        assert!(first[0].is_some() && first[1].is_some() && first[0] != first[1], "{found:?}");
        assert_eq!(first[2], None);
        assert_eq!(first, second);
        assert_eq!(*third, [first[0], None, None], "it does not hear what others get");
    }

    #[test]
    fn scripts_of_same_robots_share_one_audience() {
        let [one, two] = [1.0, 2.0].map(|value| script(value, STEPS_MIN));
        let found = audiences(&[(0, &one), (1, &one), (1, &two), (0, &two)], &[&one, &two]);
        assert!(found[0].1[0].is_some() && found[0].1[0] == found[0].1[1], "{found:?}");
    }

    #[test]
    fn robot_joins_limited_number_of_audiences_and_receives_rest_directly() {
        let scripts: Vec<_> = (0..40).map(|i| script(f64::from(i), STEPS_MIN)).collect();
        // Each script is shared with a different robot.
        let sent: Vec<_> =
            scripts.iter().zip(1..).flat_map(|(script, other)| [(0, script), (other, script)]).collect();
        let found = audiences(&sent, &scripts.iter().collect::<Vec<_>>());
        assert_eq!(found[0].1.iter().flatten().count(), AUDIENCES_MAX);
        assert_eq!(found.len(), 41);
    }
}
