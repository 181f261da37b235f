//! Reads the tree of joints in a robot's URDF: the positions of the joints, and the thickness of the links. The arm of a robot's body is
//! modelled from them.

use std::collections::{BTreeSet, HashMap};

use roxmltree::Node;

use downbeat_space::space::JointKind;
use downbeat_yaml::finding::{Code, Finding};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use super::sink::Sink;
use super::urdf::{attribute, found, numbers, parsed};

/// The joints and links of a URDF.
#[derive(Clone, Debug, Default)]
pub struct Tree {
    /// The joints, in the order of the file.
    pub joints: Vec<TreeJoint>,
    covers: HashMap<String, Cover>,
}

/// A joint between two links.
#[derive(Clone, Debug)]
pub struct TreeJoint {
    /// The name of the joint.
    pub name: String,
    /// The motion of the joint.
    pub motion: Motion,
    /// The name of the link that carries the joint.
    pub parent: String,
    /// The name of the link that the joint moves.
    pub child: String,
    /// The origin of the joint in the frame of the parent link, in metres.
    pub xyz: [f64; 3],
    /// Roll, pitch and yaw of the joint's frame in the frame of the parent link, in radians.
    pub rpy: [f64; 3],
    /// The axis of the joint as a unit vector, in the frame of the joint.
    pub axis: [f64; 3],
    /// The joint that this joint follows, if any.
    pub mimic: Option<Mimic>,
}

/// The motion of a joint.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// The joint does not move.
    Fixed,
    /// The joint turns or slides.
    By(JointKind),
    /// The joint has several degrees of freedom; the text is its type, such as `floating`.
    Other(String),
}

/// How a joint follows another joint.
#[derive(Clone, Debug)]
pub struct Mimic {
    /// The name of the followed joint.
    pub joint: String,
    /// The factor that the position of the followed joint is multiplied by.
    pub multiplier: f64,
    /// The offset that is added to the product.
    pub offset: f64,
}

/// The collision shapes of a link.
#[derive(Clone, Debug, Default)]
enum Cover {
    #[default]
    Nothing,
    /// The link has only spheres and cylinders. Each cylinder is represented by two balls around its ends. Positions are in the frame of
    /// the link.
    Round(Vec<Round>),
    /// The link has other shapes, such as meshes or boxes.
    Other,
}

#[derive(Clone, Copy, Debug)]
struct Round {
    middle: [f64; 3],
    radius: f64,
}

/// The reason why no chain of joints leads to a link.
#[derive(Clone, Debug, PartialEq)]
pub enum NoChain {
    /// No link is given, and the tree ends at more than one link. The set contains the links at which it ends.
    Branches(BTreeSet<String>),
    /// No joint leads to the link. The set contains the links to which a joint leads.
    Unknown(BTreeSet<String>),
    /// The joints form a cycle.
    Round,
}

/// Reads the tree of joints from a URDF.
pub fn tree(source: &Source) -> Result<Tree, Vec<Finding>> {
    let mut sink = Sink::default();
    let mut tree = Tree::default();
    if let Some(document) = parsed(source, &mut sink) {
        let robot = document.root_element();
        for node in robot.children().filter(|node| node.has_tag_name("link")) {
            let name = node.attribute("name").unwrap_or("").to_owned();
            tree.covers.extend(cover(node, source, &mut sink).map(|cover| (name, cover)));
        }
        for node in robot.children().filter(|node| node.has_tag_name("joint")) {
            if let Some(joint) = joint(node, source, &mut sink) {
                tree.add(joint, node, source, &mut sink);
            }
        }
    }
    if sink.findings.is_empty() { Ok(tree) } else { Err(sink.findings) }
}

impl Tree {
    fn add(&mut self, joint: TreeJoint, node: Node<'_, '_>, source: &Source, sink: &mut Sink) {
        if let Some(other) = self.joints.iter().find(|other| other.child == joint.child) {
            let message = format!(
                "the joints `{}` and `{}` have the same child link `{}`",
                shortened(&other.name),
                shortened(&joint.name),
                shortened(&joint.child)
            );
            found(node, source, Code::ImportShape, message, "at most one joint per child link", None, sink);
        }
        self.joints.push(joint);
    }

    /// Returns the joints from the root to the link `end`, in order. If `end` is `None`, the chain leads to the only link without further
    /// joints.
    pub fn chain(&self, end: Option<&str>) -> Result<Vec<&TreeJoint>, NoChain> {
        let to: HashMap<&str, &TreeJoint> =
            self.joints.iter().map(|joint| (joint.child.as_str(), joint)).collect();
        let listed = |links: Vec<&&str>| links.into_iter().map(|link| (*link).to_owned()).collect();
        let mut link = match end {
            Some(end) if to.contains_key(end) => end,
            Some(_) => return Err(NoChain::Unknown(listed(to.keys().collect()))),
            None => {
                let is_parent = |link: &str| self.joints.iter().any(|joint| joint.parent == link);
                let leaves: Vec<&&str> = to.keys().filter(|link| !is_parent(link)).collect();
                match *leaves {
                    [leaf] => leaf,
                    [] => return Err(NoChain::Round),
                    _ => return Err(NoChain::Branches(listed(leaves))),
                }
            }
        };
        let mut chain = Vec::new();
        while let Some(joint) = to.get(link) {
            if chain.len() == self.joints.len() {
                return Err(NoChain::Round);
            }
            chain.push(*joint);
            link = &joint.parent;
        }
        chain.reverse();
        Ok(chain)
    }

    /// Returns the radius, in metres, of a capsule that encloses the child link of a joint. The axis of the capsule leads from this joint
    /// to `next`, the origin of the next joint. A link without shapes has radius 0. `None` if the link has shapes other than spheres and
    /// cylinders, or if it has any shapes and slides.
    pub fn radius(&self, joint: &TreeJoint, next: [f64; 3]) -> Option<f64> {
        match self.covers.get(&joint.child) {
            None | Some(Cover::Nothing) => Some(0.0),
            // A sliding link is not on the line from its joint's origin.
            Some(Cover::Round(rounds)) if joint.motion != Motion::By(JointKind::Prismatic) => Some(
                rounds.iter().map(|round| to_line(round.middle, next) + round.radius).fold(0.0, f64::max),
            ),
            Some(Cover::Round(_) | Cover::Other) => None,
        }
    }

    /// Whether any link has collision shapes.
    pub fn has_shapes(&self) -> bool {
        self.covers.values().any(|cover| !matches!(cover, Cover::Nothing))
    }
}

/// Returns the distance between a point and the line segment from the origin to `end`.
fn to_line(point: [f64; 3], end: [f64; 3]) -> f64 {
    let squared: f64 = end.iter().map(|part| part * part).sum();
    let along: f64 = point.iter().zip(&end).map(|(a, b)| a * b).sum();
    let share = if squared > 0.0 { (along / squared).clamp(0.0, 1.0) } else { 0.0 };
    (0..3).map(|i| (point[i] - share * end[i]).powi(2)).sum::<f64>().sqrt()
}

fn child<'a, 'i>(node: Node<'a, 'i>, tag: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|child| child.has_tag_name(tag))
}

fn joint(node: Node<'_, '_>, source: &Source, sink: &mut Sink) -> Option<TreeJoint> {
    let name = node.attribute("name").unwrap_or("").to_owned();
    let motion = match node.attribute("type").unwrap_or("") {
        "fixed" => Motion::Fixed,
        "revolute" | "continuous" => Motion::By(JointKind::Revolute),
        "prismatic" => Motion::By(JointKind::Prismatic),
        other => Motion::Other(shortened(other).to_string()),
    };
    let link = |tag: &str| Some(child(node, tag)?.attribute("link")?.to_owned());
    let (Some(parent), Some(to)) = (link("parent"), link("child")) else {
        let message = format!("the joint `{}` has no parent or child link", shortened(&name));
        let expected = "<parent link=\"...\"/> and <child link=\"...\"/>";
        found(node, source, Code::MissingKey, message, expected, None, sink);
        return None;
    };
    let [xyz, rpy] = origin(node, source, sink)?;
    let axis = match child(node, "axis") {
        Some(axis) => numbers(axis, "xyz", source, sink)?.unwrap_or([1.0, 0.0, 0.0]),
        None => [1.0, 0.0, 0.0],
    };
    let long = axis.iter().map(|part| part * part).sum::<f64>().sqrt();
    if !(long >= 1e-9 && long.is_finite()) {
        let message = format!("the axis of the joint `{}` is not a valid direction", shortened(&name));
        found(node, source, Code::ImportShape, message, "a vector", None, sink);
        return None;
    }
    let mimic = match child(node, "mimic") {
        Some(mimic) => Some(Mimic {
            joint: mimic.attribute("joint").unwrap_or("").to_owned(),
            multiplier: attribute(mimic, "multiplier", source, sink)?.unwrap_or(1.0),
            offset: attribute(mimic, "offset", source, sink)?.unwrap_or(0.0),
        }),
        None => None,
    };
    Some(TreeJoint { name, motion, parent, child: to, xyz, rpy, axis: axis.map(|part| part / long), mimic })
}

/// Reads the element `<origin xyz="..." rpy="..."/>` of a node. Missing parts are zero; `None` if a part is invalid.
fn origin(node: Node<'_, '_>, source: &Source, sink: &mut Sink) -> Option<[[f64; 3]; 2]> {
    let Some(origin) = child(node, "origin") else { return Some([[0.0; 3]; 2]) };
    let [xyz, rpy] = ["xyz", "rpy"].map(|name| numbers(origin, name, source, sink));
    Some([xyz?.unwrap_or_default(), rpy?.unwrap_or_default()])
}

fn cover(link: Node<'_, '_>, source: &Source, sink: &mut Sink) -> Option<Cover> {
    let mut rounds = Vec::new();
    let mut collisions = link.children().filter(|node| node.has_tag_name("collision")).peekable();
    if collisions.peek().is_none() {
        return Some(Cover::Nothing);
    }
    for collision in collisions {
        let [xyz, rpy] = origin(collision, source, sink)?;
        let shape = |tag| child(child(collision, "geometry")?, tag);
        let (shape, length) = match (shape("sphere"), shape("cylinder")) {
            (Some(sphere), _) => (sphere, 0.0),
            (_, Some(cylinder)) => (cylinder, attribute(cylinder, "length", source, sink)?.unwrap_or(0.0)),
            _ => return Some(Cover::Other),
        };
        let radius = attribute(shape, "radius", source, sink)?.unwrap_or(0.0);
        let along = upright(rpy).map(|part| part * length / 2.0);
        for sign in [-1.0, 1.0] {
            let middle = std::array::from_fn(|i| xyz[i] + sign * along[i]);
            rounds.push(Round { middle, radius });
        }
    }
    Some(Cover::Round(rounds))
}

/// Returns the direction of the z axis after rotations about the fixed axes: roll, pitch, then yaw, in radians.
fn upright([roll, pitch, yaw]: [f64; 3]) -> [f64; 3] {
    let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
    [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(body: &str) -> Result<Tree, Vec<Finding>> {
        tree(&Source { name: "arm.urdf".into(), text: format!("<robot name=\"arm\">\n{body}\n</robot>") })
    }

    fn between(name: &str, parent: &str, child: &str, more: &str) -> String {
        format!(
            "<joint name=\"{name}\" type=\"revolute\">{more}<parent link=\"{parent}\"/><child link=\"{child}\"/></joint>\n"
        )
    }

    #[track_caller]
    fn named(chain: Result<Vec<&TreeJoint>, NoChain>) -> Vec<&str> {
        chain.unwrap().into_iter().map(|joint| joint.name.as_str()).collect()
    }

    #[test]
    fn chain_leads_from_the_root_to_the_chosen_end_link() {
        let hand = between("finger", "hand", "tip", "") + &between("eye", "hand", "camera", "");
        let arm = between("wrist", "arm", "hand", "") + &between("elbow", "base", "arm", "");
        let tree_of = read(&(hand + &arm)).unwrap();
        assert_eq!(named(tree_of.chain(Some("tip"))), ["elbow", "wrist", "finger"]);
        assert_eq!(named(tree_of.chain(Some("hand"))), ["elbow", "wrist"]);
        let leaves = ["camera", "tip"].map(str::to_owned).into();
        assert_eq!(tree_of.chain(None).unwrap_err(), NoChain::Branches(leaves));
        assert!(matches!(tree_of.chain(Some("base")), Err(NoChain::Unknown(_))));
        let round = read(&(between("a", "x", "y", "") + &between("b", "y", "x", ""))).unwrap();
        assert_eq!(round.chain(None).unwrap_err(), NoChain::Round);
        assert_eq!(round.chain(Some("x")).unwrap_err(), NoChain::Round);
    }

    #[test]
    fn capsule_around_link_encloses_round_shapes() {
        let shape = |origin: &str, shape: &str| {
            format!("<collision>{origin}<geometry>{shape}</geometry></collision>")
        };
        let lying = shape(
            "<origin xyz=\"0.2 0 0.01\" rpy=\"0 1.5707963267948966 0\"/>",
            "<cylinder length=\"0.4\" radius=\"0.05\"/>",
        );
        let link =
            |inner: &str| format!("<link name=\"arm\">{inner}</link>") + &between("elbow", "base", "arm", "");
        let radius = |inner: &str| {
            let tree = read(&link(inner)).unwrap();
            tree.radius(&tree.joints[0], [0.4, 0.0, 0.0])
        };
        assert!((radius(&lying).unwrap() - 0.06).abs() < 1e-9);
        let both = lying.clone() + &shape("<origin xyz=\"0.1 0.1 0\"/>", "<sphere radius=\"0.02\"/>");
        assert!((radius(&both).unwrap() - 0.12).abs() < 1e-9);
        assert_eq!(radius(&(lying + &shape("", "<box size=\"1 1 1\"/>"))), None);
        assert_eq!(radius(""), Some(0.0));
    }

    #[test]
    fn all_faults_are_reported_at_once_with_their_positions() {
        let faults = between("a", "x", "y", "<origin xyz=\"0 1\"/>")
            + &between("b", "x", "z", "<axis xyz=\"0 0 0\"/>")
            + "<joint name=\"c\" type=\"fixed\"><parent link=\"x\"/></joint>\n"
            + &between("d", "x", "v", "")
            + &between("e", "x", "v", "");
        let found: Vec<(usize, Code)> =
            read(&faults).unwrap_err().iter().map(|finding| (finding.line, finding.code)).collect();
        let expected =
            [(2, Code::ImportNumber), (3, Code::ImportShape), (4, Code::MissingKey), (6, Code::ImportShape)];
        assert_eq!(found, expected);
    }
}
