//! The movements of a cue: one that all of its robots share, or one for each robot if the movement uses `$index` or `$count`.

use std::borrow::Cow;
use std::collections::HashMap;

use urrcp::Span;

use super::cue::Overriding;
use super::library::Library;
use super::movement::{Shaping, movement};
use super::{Movement, Name};
use crate::composed::composed;
use crate::fields::{At, Reader, Robot};
use crate::finding::Code;
use crate::fleet::Fleet;
use crate::shown::shortened;

/// The fleet, for finding the robots that names refer to before cues are checked.
pub(super) struct Roster<'a> {
    pub(super) fleet: &'a Fleet,
    /// Index of each robot in the fleet, by the robot's name in Unicode normalization form C.
    index_of: HashMap<Cow<'a, str>, usize>,
}

impl<'a> Roster<'a> {
    pub(super) fn new(fleet: &'a Fleet) -> Self {
        let index_of =
            fleet.robots.iter().enumerate().map(|(i, robot)| (composed(robot.id.as_str()), i)).collect();
        Self { fleet, index_of }
    }

    /// Returns the robots that the names refer to, in the order of the names and without duplicates. Skips unknown names.
    pub(super) fn robots(&self, roles: &HashMap<String, Vec<Name>>, names: &[Name]) -> Vec<usize> {
        let mut seen = std::collections::HashSet::new();
        let of_role = |name: &Name| roles.get(&name.text).cloned().unwrap_or_else(|| vec![name.clone()]);
        let all = names.iter().flat_map(of_role).flat_map(|name| self.of_fleet(&name.text));
        all.filter(|robot| seen.insert(*robot)).collect()
    }

    /// Reports a role whose name is that of a robot or a group of the fleet.
    pub(super) fn check_role(&self, reader: &mut Reader, at: &At<'_>, name: &str) {
        let whose = match self.index_of.contains_key(composed(name).as_ref()) {
            true => "robot",
            false if self.fleet.groups.contains_key(name) => "group",
            false => return,
        };
        let message = format!("the role `{}` has the same name as a {whose}", shortened(name));
        let hint = Some("rename the role here and in the cues that use it".to_owned());
        reader.add(Code::NameClash, at.key_place(), message, "a unique name", hint);
    }

    fn of_fleet(&self, name: &str) -> Vec<usize> {
        if let Some(&index) = self.index_of.get(composed(name).as_ref()) {
            return vec![index];
        }
        let members = self.fleet.groups.get(name).into_iter().flatten();
        members.filter_map(|id| self.index_of.get(composed(id.as_str()).as_ref()).copied()).collect()
    }
}

/// The movements of the robots of a cue.
#[derive(Default)]
pub(super) struct Movements {
    pub(super) shared: Movement,
    pub(super) overrides: Vec<(Name, Movement)>,
    /// Movements of single robots. For each robot of the cue, `own_of` contains the index of the robot's movement in this list.
    pub(super) own: Vec<Movement>,
    pub(super) own_of: Vec<Option<usize>>,
}

impl Movements {
    /// Sets the length of all movements to at least `length`, because a group movement may take longer than the tracks.
    pub(super) fn last_at_least(&mut self, length: Span) {
        let overrides = self.overrides.iter_mut().map(|(_, movement)| movement);
        for movement in std::iter::once(&mut self.shared).chain(overrides).chain(&mut self.own) {
            movement.length = movement.length.max(length);
        }
    }
}

/// Reads the movement of a cue and its overrides.
pub(super) fn movements(
    reader: &mut Reader,
    library: &Library<'_>,
    base: &Shaping<'_>,
    overriding: &[Overriding<'_>],
    names: &[Name],
) -> Movements {
    let (shared, differs) = probe(reader, library, base);
    let mut read = Movements { shared, ..Movements::default() };
    let mut differ = Vec::with_capacity(overriding.len());
    for Overriding { name, shaping } in overriding {
        let (movement, differs) = probe(reader, library, shaping);
        differ.push(differs);
        read.overrides.push((name.clone(), movement));
    }
    if !differs && !differ.contains(&true) {
        return read;
    }
    let mut override_of = HashMap::new();
    for (index, Overriding { name, .. }) in overriding.iter().enumerate() {
        let robots = library.robots(std::slice::from_ref(name));
        override_of.extend(robots.into_iter().map(|robot| (robot, index)));
    }
    let mut known: HashMap<(Option<usize>, Vec<u64>), usize> = HashMap::new();
    let robots = library.robots(names);
    let faults = reader.found.len();
    for (index, robot) in robots.iter().enumerate() {
        let overridden = override_of.get(robot).copied();
        let (shaping, differs) = match overridden {
            Some(index) => (&overriding[index].shaping, differ[index]),
            None => (base, differs),
        };
        // If one robot has a fault, the others are likely to have the same fault.
        if !differs || reader.found.len() > faults {
            read.own_of.push(None);
            continue;
        }
        let own = of_robot(reader, library, shaping, Robot { index, count: robots.len() });
        let results = std::mem::take(&mut reader.robots.results);
        let number = *known.entry((overridden, results)).or_insert_with(|| {
            read.own.push(own);
            read.own.len() - 1
        });
        read.own_of.push(Some(number));
    }
    read
}

/// Reads a movement for the only robot of an assumed group. Also returns whether the movement differs between robots. If it does,
/// discards what was read.
fn probe(reader: &mut Reader, library: &Library<'_>, shaping: &Shaping<'_>) -> (Movement, bool) {
    let before = (reader.mark(), reader.knots);
    let movement = of_robot(reader, library, shaping, Robot { index: 0, count: 1 });
    if !reader.robots.asked {
        return (movement, false);
    }
    reader.forget(&before.0);
    reader.knots = before.1;
    (Movement::default(), true)
}

fn of_robot(reader: &mut Reader, library: &Library<'_>, shaping: &Shaping<'_>, robot: Robot) -> Movement {
    reader.robots.current = Some(robot);
    reader.robots.asked = false;
    reader.robots.results.clear();
    let movement = movement(reader, library, shaping);
    reader.robots.current = None;
    movement
}
