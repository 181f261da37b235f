//! Reads the arm of a body from the URDF file that the key `urdf` specifies.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use urrcp::InitializationBlock;

use super::body::{ANGLES, LENGTHS, by_name, fixed, of_device};
use super::declared::device_named;
use super::joints::JOINTS_MAX;
use downbeat_import::urdf_tree::{Motion, NoChain, Tree, TreeJoint, tree};
use downbeat_reader::fields::{At, Reader};
use downbeat_space::space::{Coordinate, Joint, JointKind};
use downbeat_yaml::finding::{Code, Finding, names, one_of};
use downbeat_yaml::node::Node;
use downbeat_yaml::project::Project;
use downbeat_yaml::shown::shortened;

/// The URDF files read so far, by path, because many robots share a file.
pub(super) struct Urdfs {
    folder: PathBuf,
    project: Project,
    read: HashMap<PathBuf, Option<Rc<Tree>>>,
    /// The findings in the URDF files.
    pub(super) elsewhere: Vec<Finding>,
}

/// The keys of a body that describe an arm from a URDF.
pub(super) struct UrdfKeys<'a> {
    pub(super) urdf: At<'a>,
    pub(super) end: Option<At<'a>>,
    pub(super) devices: Option<At<'a>>,
    /// The radius of all links, in metres. `None` if the URDF determines the radius of each link.
    pub(super) radius: Option<f64>,
}

/// For each joint name, the device that moves the joint, or the joint's fixed value.
struct Movers<'a> {
    named: BTreeMap<&'a str, At<'a>>,
    /// The number of names in `devices` that are not joints of the URDF.
    unknown: usize,
    init: &'a InitializationBlock,
}

impl Urdfs {
    pub(super) fn new(folder: &Path, project: Project) -> Self {
        Self { folder: folder.to_path_buf(), project, read: HashMap::new(), elsewhere: Vec::new() }
    }

    fn tree(&mut self, findings: &mut Reader, at: &At<'_>) -> Option<Rc<Tree>> {
        let path = self.folder.join(findings.text(at, "the path of a URDF")?.as_ref());
        if let Some(read) = self.read.get(&path) {
            return read.clone();
        }
        let read = match self.project.read(&path) {
            Ok(source) => tree(&source).map_err(|found| self.elsewhere.extend(found)).ok(),
            Err(finding) if finding.code == Code::OutsideProject => {
                findings.add_named(at.place(), finding);
                None
            }
            Err(finding) => {
                let message = format!("cannot read the URDF `{}`: {}", path.display(), finding.message);
                let hint = Some("the path is relative to the folder of the fleet file".to_owned());
                findings.add(Code::Unreadable, at.place(), message, "a readable file", hint);
                None
            }
        };
        let read = read.map(Rc::new);
        self.read.insert(path, read.clone());
        read
    }

    /// Reads the joints from the root of a URDF to the link at which the arm ends. The origin of that link is the tip of the arm.
    pub(super) fn read_arm(
        &mut self,
        findings: &mut Reader,
        keys: &UrdfKeys<'_>,
        init: &InitializationBlock,
    ) -> Option<Vec<Joint>> {
        let tree = self.tree(findings, &keys.urdf)?;
        let end = keys.end.and_then(|at| findings.name(&at, "the link at which the arm ends"));
        if keys.end.is_some() && end.is_none() {
            return None;
        }
        let chain = tree.chain(end.as_deref());
        let chain = chain.map_err(|fault| tell_no_chain(findings, keys, end.as_deref(), fault)).ok()?;
        if chain.len() > JOINTS_MAX {
            let message = format!("the arm has {}", downbeat_yaml::render::counted(chain.len(), "joint"));
            findings.add(
                Code::TooMuch,
                keys.urdf.place(),
                message,
                format!("at most {JOINTS_MAX} joints"),
                None,
            );
            return None;
        }
        let before = findings.found.len();
        let movers = Movers::of(findings, keys, &tree, init);
        movers.tell_missing(findings, keys, &chain);
        let radii = radii(findings, keys, &tree, &chain);
        let values: Vec<Option<Coordinate>> =
            chain.iter().map(|joint| movers.value(findings, keys, joint)).collect();
        let joints = chain.iter().zip(values).zip(radii?).map(|((joint, value), radius)| {
            let kind = if let Motion::By(kind) = joint.motion { kind } else { JointKind::Revolute };
            let TreeJoint { name, xyz, rpy, axis, .. } = (*joint).clone();
            Some(Joint { name, kind, xyz, rpy, axis, value: value?, radius })
        });
        let joints: Option<Vec<Joint>> = joints.collect();
        joints.filter(|_| findings.found.len() == before)
    }
}

fn tell_no_chain(findings: &mut Reader, keys: &UrdfKeys<'_>, end: Option<&str>, fault: NoChain) {
    let at = keys.end.as_ref().unwrap_or(&keys.urdf);
    let (message, expected, hint) = match &fault {
        NoChain::Branches(leaves) => (
            format!("the URDF has {} end links", leaves.len()),
            "a single arm, from the root to one end link".to_owned(),
            Some(format!(
                "set `end` to the last link of the arm: one of {}",
                names(leaves.iter().map(String::as_str))
            )),
        ),
        NoChain::Unknown(links) => {
            let end = end.unwrap_or_default();
            let known = || links.iter().map(String::as_str);
            let message = format!("no joint leads to the link `{}`", shortened(end));
            (message, one_of(known()), findings.did_you_mean(end, known()))
        }
        NoChain::Round => (
            "the joints form a cycle".to_owned(),
            "a chain of joints from a root to an end link".to_owned(),
            None,
        ),
    };
    findings.add(Code::ImportShape, at.place(), message, expected, hint);
}

/// Returns the radius of each link of the arm, in metres. Reports all links without a known radius in one finding.
fn radii(findings: &mut Reader, keys: &UrdfKeys<'_>, tree: &Tree, chain: &[&TreeJoint]) -> Option<Vec<f64>> {
    if let Some(radius) = keys.radius {
        return Some(vec![radius; chain.len()]);
    }
    let nexts = chain.iter().skip(1).map(|joint| joint.xyz).chain([[0.0; 3]]);
    let radii: Vec<Option<f64>> =
        chain.iter().zip(nexts).map(|(joint, next)| tree.radius(joint, next)).collect();
    let untold = chain.iter().zip(&radii).filter(|(_, radius)| radius.is_none());
    let untold: Vec<&str> = untold.map(|(joint, _)| joint.child.as_str()).collect();
    if untold.is_empty() && tree.has_shapes() {
        return radii.into_iter().collect();
    }
    let message = match untold.as_slice() {
        [] => "the description has no collision shapes".to_owned(),
        links => {
            format!("cannot determine a radius from the collision shapes of {}", names(links.iter().copied()))
        }
    };
    let hint = Some("add the radius of the links in metres, as in `radius: 0.06`".to_owned());
    findings.add(
        Code::MissingKey,
        keys.urdf.place(),
        message,
        "cylinders or spheres as collision shapes, or a `radius`",
        hint,
    );
    None
}

const fn units(kind: JointKind) -> &'static [(&'static str, f64)] {
    match kind {
        JointKind::Revolute => &ANGLES,
        JointKind::Prismatic => &LENGTHS,
    }
}

impl<'a> Movers<'a> {
    fn of(findings: &mut Reader, keys: &'a UrdfKeys<'a>, tree: &Tree, init: &'a InitializationBlock) -> Self {
        let (mut named, mut unknown) = (BTreeMap::new(), 0);
        let known = || tree.joints.iter().map(|joint| joint.name.as_str());
        let entries =
            keys.devices.as_ref().map(|at| findings.entries(at, "a map from each joint to its device"));
        for (name, at) in entries.unwrap_or_default() {
            if !known().any(|joint| joint == name) {
                let message = format!("the URDF has no joint `{}`", shortened(name));
                let hint = findings.did_you_mean(name, known());
                findings.add(Code::UnknownWord, at.key_place(), message, one_of(known()), hint);
                unknown += 1;
            }
            named.insert(name, at);
        }
        Self { named, unknown, init }
    }

    /// Returns the name of the joint whose device moves `joint`: the joint that `joint` mimics, or `joint` itself.
    fn leader(joint: &TreeJoint) -> &str {
        joint.mimic.as_ref().map_or(&joint.name, |mimic| &mimic.joint)
    }

    /// Reports all joints of the arm without a device in one finding. Reports nothing if a joint name in `devices` is wrong.
    fn tell_missing(&self, findings: &mut Reader, keys: &UrdfKeys<'_>, chain: &[&TreeJoint]) {
        let moving = chain.iter().filter(|joint| matches!(joint.motion, Motion::By(_)));
        let missing = moving.map(|joint| Self::leader(joint)).filter(|name| !self.has(name));
        let missing: std::collections::BTreeSet<&str> = missing.collect();
        if let Some(first) = missing.first().filter(|_| self.unknown == 0) {
            let joints = if missing.len() == 1 { "joint" } else { "joints" };
            let message =
                format!("the robot has no device for the {joints} {}", names(missing.iter().copied()));
            let devices = self.init.devices.iter().map(|device| device.id.as_str());
            let hint = Some(format!(
                "assign each joint a device, or a fixed number if it does not move: `devices: {{{first}: 0}}`"
            ));
            findings.add(Code::UnknownDevice, keys.urdf.place(), message, one_of(devices), hint);
        }
    }

    fn has(&self, joint: &str) -> bool {
        self.named.contains_key(joint) || device_named(self.init, joint).is_some()
    }

    /// Returns the position of a joint: either a device sets it, or it is fixed. `None` if the position cannot be determined, in which
    /// case a finding reports the fault.
    fn value(&self, findings: &mut Reader, keys: &UrdfKeys<'_>, joint: &TreeJoint) -> Option<Coordinate> {
        let kind = match &joint.motion {
            Motion::Fixed => return Some(Coordinate::Fixed(0.0)),
            Motion::By(kind) => *kind,
            Motion::Other(kind) => {
                let message =
                    format!("the type `{kind}` of the joint `{}` is not supported", shortened(&joint.name));
                let expected = "revolute, continuous, prismatic or fixed joints";
                findings.add(Code::ImportShape, keys.urdf.place(), message, expected, None);
                return None;
            }
        };
        let name = Self::leader(joint);
        let value = match self.named.get(name) {
            Some(at) if matches!(at.node, Node::Number(_)) => fixed(findings, at, units(kind)),
            Some(at) => of_device(findings, at, [None; 2], self.init, units(kind)),
            None if self.has(name) => by_name(findings, &keys.urdf, name, self.init, units(kind)),
            None => None,
        }?;
        let Some(mimic) = &joint.mimic else { return Some(value) };
        Some(match value {
            Coordinate::Fixed(value) => Coordinate::Fixed(mimic.offset + mimic.multiplier * value),
            Coordinate::Device { device, scale, offset } => Coordinate::Device {
                device,
                scale: mimic.multiplier * scale,
                offset: mimic.offset + mimic.multiplier * offset,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use downbeat_space::space::{Body, Coordinate, JointKind};

    use crate::fleet::read_fleet;

    const URDF: &str = r#"<robot name="arm">
  <link name="base"/><link name="upper"/><link name="lower"/><link name="slide"/><link name="hand"/>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.4" rpy="0 1.5707963267948966 0"/><axis xyz="0 0 2"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.5 0 0"/>
    <mimic joint="shoulder" multiplier="-2" offset="0.1"/></joint>
  <joint name="rail" type="prismatic"><parent link="lower"/><child link="slide"/><axis xyz="0 1 0"/></joint>
  <joint name="flange" type="fixed"><parent link="slide"/><child link="hand"/><origin xyz="0.1 0 0"/></joint>
</robot>"#;

    fn body(keys: &str) -> Result<Body, Vec<String>> {
        let device = |id: &str, unit: &str| {
            let limits = "min_value: -9, max_value: 9, granularity: 0.1";
            format!(
                "  - id: {id}\n    name: {id}\n    unit: {unit}\n    available_control_types: {{position: {{{limits}}}}}\n"
            )
        };
        let init = "id: arm\napi_version: \"1\"\ndevices:\n".to_owned()
            + &device("pan", "deg")
            + &device("rail", "mm");
        let folder = tempfile::tempdir().unwrap();
        let fleet = format!("robots: {{a: {{init: arm.yaml, address: sim, body: {{{keys}}}}}}}");
        for (name, text) in [("arm.urdf", URDF), ("arm.yaml", &init), ("fleet.yaml", &fleet)] {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        let (fleet, findings) = read_fleet(&folder.path().join("fleet.yaml"));
        let body = fleet.and_then(|mut fleet| fleet.robots.remove(0).body);
        body.ok_or_else(|| findings.into_iter().map(|finding| finding.message).collect())
    }

    #[test]
    fn urdf_becomes_a_chain_of_joints() {
        let body = body("urdf: arm.urdf, devices: {shoulder: pan}, radius: 0.05").unwrap();
        let names: Vec<&str> = body.joints.iter().map(|joint| joint.name.as_str()).collect();
        assert_eq!(names, ["shoulder", "elbow", "rail", "flange"]);
        assert!(body.joints.iter().all(|joint| joint.radius == 0.05));
        assert_eq!((body.joints[0].xyz, body.joints[0].axis), ([0.0, 0.0, 0.4], [0.0, 0.0, 1.0]));
        assert_eq!(body.joints[2].kind, JointKind::Prismatic);
        let Coordinate::Device { device, scale, offset } = &body.joints[1].value else { panic!("fixed") };
        assert_eq!((device.as_str(), *offset), ("pan", 0.1));
        assert!((scale + 2.0_f64.to_radians()).abs() < 1e-12, "{scale}");
        assert_eq!(body.joints[3].value, Coordinate::Fixed(0.0));
    }

    #[track_caller]
    fn faults(keys: &str, expected: &[&str]) {
        let found = body(keys).unwrap_err();
        assert_eq!(found, expected, "{keys}");
    }

    #[test]
    fn missing_part_is_reported_once() {
        faults("urdf: arm.urdf, radius: 0.05", &["the robot has no device for the joint `shoulder`"]);
        faults("urdf: arm.urdf, devices: {shoulder: 30}", &["the description has no collision shapes"]);
        faults(
            "urdf: arm.urdf, devices: {shoulder: pan}, end: foot, radius: 0.05",
            &["no joint leads to the link `foot`"],
        );
        faults(
            "urdf: arm.urdf, devices: {shoulder: pan, wrist: pan}, tip: [0, 0, 1], radius: 0.05",
            &["the URDF has no joint `wrist`", "the URDF already defines `tip`"],
        );
        faults("end: hand, x: 1", &["`end` needs an arm from a URDF"]);
    }
}
