//! Names whose letters have several Unicode encodings.

use crate::{Code, Finding, Folder, Project, Severity, Source, compile, read_fleet};

/// The letter `ö` as one character; `DECOMPOSED` has it as a letter with a combining mark.
const COMPOSED: &str = "K\u{f6}pf";
const DECOMPOSED: &str = "Ko\u{308}pf";

const ROBOT: &str = "id: any
api_version: \"1\"
devices:
  - id: NAME
    interpolation: linear
    available_control_types:
      position: {min_value: 0, max_value: 90, granularity: 0.5}
      script: {max_number_of_steps: 8}
";

const SCENARIO: &str = "scenario: s
roles: {NAME-role: [NAME]}
moves: {NAME-move: {parameters: {NAME: 5}, tracks: {NAME: [{at: 0s, to: 0}, {at: 1s, to: $NAME}]}}}
cues:
  - {cue: NAME-cue, robots: NAME-role, move: OTHER-move, parameters: {OTHER: 9}}
  - {after: OTHER-cue, robots: OTHERs, tracks: {OTHER: [{at: 0s, to: 9}, {at: 1s, to: 2}]}}
";

/// Returns the findings of a show whose files contain a name in these encodings: in the description, in the fleet file, in the scenario,
/// and a second time in the scenario.
fn found([robot, fleet, scenario, other]: [&str; 4], file: [&str; 2]) -> Vec<Finding> {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: String| std::fs::write(folder.path().join(name), text).unwrap();
    write(&format!("{}.yaml", file[0]), ROBOT.replace("NAME", robot));
    let robots = format!(
        "robots: {{{fleet}: {{init: {}.yaml, address: sim, limits: {{{other}: {{speed: 90}}}}}}}}",
        file[1]
    );
    write("fleet.yaml", format!("{robots}\ngroups: {{{fleet}s: [{other}]}}\n"));
    let (fleet, mut findings) = read_fleet(&folder.path().join("fleet.yaml"));
    let text = SCENARIO.replace("NAME", scenario).replace("OTHER", other);
    if let Some(fleet) = fleet {
        let files = Folder::within(folder.path().to_path_buf(), Project::of_folder(folder.path()));
        findings.extend(compile(&Source { name: "s.yaml".into(), text }, &fleet, &files).findings);
    }
    findings.into_iter().filter(|finding| finding.severity == Severity::Error).collect()
}

#[test]
fn composed_and_decomposed_names_are_equal() {
    let forms = [COMPOSED, DECOMPOSED];
    for number in 0..16 {
        let names = [0, 1, 2, 3].map(|bit| forms[number >> bit & 1]);
        let file = [names[0], names[3]];
        assert_eq!(found(names, file), [], "{names:?}");
    }
}

#[test]
fn robots_differing_only_in_name_encoding_are_one_fault() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("arm.yaml"), ROBOT).unwrap();
    let robot = "{init: arm.yaml, address: sim}";
    let text = format!("robots:\n  {COMPOSED}: {robot}\n  {DECOMPOSED}: {robot}\n");
    std::fs::write(folder.path().join("fleet.yaml"), text).unwrap();
    let (_, findings) = read_fleet(&folder.path().join("fleet.yaml"));
    let found: Vec<_> = findings.iter().map(|finding| (finding.code, finding.line)).collect();
    assert_eq!(found, [(Code::DuplicateKey, 3)], "{findings:#?}");
}

#[test]
fn unknown_names_in_any_encoding_are_reported_at_their_columns() {
    let text = "scenario: s\ncues:\n  - {robots: arm, tracks: {d: [{at: 0s, to: 0}]}}\n  - {robots: arm, tracks: {K\u{f6}pf: [{at: 0s, to: 0}], Ko\u{308}pfe: [{at: 0s, to: 100}]}}\n";
    let found =
        compile(&Source { name: "s.yaml".into(), text: text.into() }, &super::fleet(), &crate::NoFiles)
            .findings;
    let places: Vec<_> = found.iter().map(|finding| (finding.code, finding.line, finding.column)).collect();
    assert_eq!(places, [(Code::UnknownDevice, 4, 28), (Code::UnknownDevice, 4, 53)], "{found:#?}");
}
