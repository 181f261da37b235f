//! URDF files: the initialization block that is created from one, compared with the results of another parser (urdf-rs).

use super::fixture_of;
use downbeat_yaml::source::Source;
use urrcp::InitializationBlock;

use crate::urdf;

fn source(text: &str) -> Source {
    Source { name: "robot.urdf".into(), text: text.to_owned() }
}

#[test]
fn joints_and_limits_match_an_independent_reader() {
    let text = String::from_utf8(fixture_of("06-flexible.urdf")).unwrap();
    let outcome = urdf(&source(&text), None);
    assert_eq!(outcome.findings, []);
    let block: InitializationBlock = serde_yaml::from_str(&outcome.files[0].text).unwrap();
    let robot = urdf_rs::read_from_string(&text).unwrap();
    let moving: Vec<_> =
        robot.joints.iter().filter(|joint| joint.joint_type != urdf_rs::JointType::Fixed).collect();
    assert_eq!(
        (block.id.as_str(), block.devices.len(), outcome.devices),
        (robot.name.as_str(), moving.len(), 8)
    );
    for joint in moving {
        let device = block.device(&joint.name).unwrap();
        let limits = device.available_control_types.limits(urrcp::ControlType::Position).unwrap();
        let unit = if joint.joint_type == urdf_rs::JointType::Prismatic { "m" } else { "rad" };
        assert_eq!(device.unit.as_ref().map(ToString::to_string).as_deref(), Some(unit));
        if joint.joint_type != urdf_rs::JointType::Continuous {
            assert_eq!((limits.min_value, limits.max_value), (joint.limit.lower, joint.limit.upper));
            let speed = format!("{}: {{speed: {}}}", joint.name, joint.limit.velocity);
            assert!(outcome.files[1].text.contains(&speed), "{}", outcome.files[1].text);
        }
    }
    for part in [
        "left out 7 fixed joints",
        "limited to one turn in each direction",
        "granularity, max_error (both set to",
        "left out 3 efforts",
    ] {
        assert!(outcome.notes.iter().any(|note| note.contains(part)), "{part}: {:?}", outcome.notes);
    }
}

#[test]
fn invalid_descriptions_are_refused_with_the_line() {
    #[track_caller]
    fn check(text: &str, parts: &[&str]) {
        let outcome = urdf(&source(text), None);
        let shown = downbeat_yaml::render::render(&outcome.findings, false);
        assert!(outcome.files.is_empty() && parts.iter().all(|part| shown.contains(part)), "{shown}");
    }
    let joint = |inner: &str| format!("<robot name='r'>\n<joint name='a' {inner}</joint></robot>");
    check("", &["DB0002"]);
    check("<robot>\n<link></robot>", &["DB0002", "robot.urdf:2:"]);
    check("<!DOCTYPE r [<!ENTITY a 'b'>]><robot/>", &["DB0002"]);
    check("<sdf/>", &["DB0066", "the root element is `sdf`"]);
    check(
        "<robot xmlns:xacro='http://ros.org/wiki/xacro'>\n<xacro:macro/></robot>",
        &["robot.urdf:2:1", "xacro robot.urdf.xacro"],
    );
    check("<robot name='r'/>", &["the robot has no movable joints"]);
    check(&joint("type='revolute'>"), &["DB0006", "robot.urdf:2:1", "missing limits of the joint `a`"]);
    check(
        &joint("type='revolute'><limit lower='1' upper='-1' velocity='1'/>"),
        &["invalid limits of the joint `a`: from 1 to -1"],
    );
    check(
        &joint("type='revolute'><limit lower='nan' upper='1'/>"),
        &["DB0061", "robot.urdf:2:47", "`lower` is `nan`"],
    );
    check(&joint("type='revolute'><limit lower='1e999' upper='1'/>"), &["DB0061"]);
    check(&joint("type='hinge'>"), &["has the unknown type `hinge`"]);
    check("<robot><joint name='' type='continuous'/></robot>", &["DB0067"]);
    let long = format!("<robot name='{}'><joint name='a' type='continuous'/></robot>", "r".repeat(257));
    check(&long, &["DB0067", "257 characters", "--kind NAME"]);
    let twice = "<robot><joint name='a' type='continuous'/>\n<joint name='a' type='continuous'/></robot>";
    check(twice, &["robot.urdf:2:1", "duplicate joint name `a`"]);
    check(&"<a>".repeat(100_000), &["DB0002"]);
    check(&"<joint/>".repeat(3 << 20), &["DB0068"]);
    let many: String = (0..2_000).map(|n| format!("<joint name='j{n}' type='continuous'/>")).collect();
    check(&format!("<robot>{many}</robot>"), &["DB0068", "2000 joints"]);
}
