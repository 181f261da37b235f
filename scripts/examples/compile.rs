//! Compiles a scenario and prints the number of steps for each device, or the findings.
//!
//! `cargo run --example compile -- ../fleet.yaml examples/swap.yaml`
#![expect(clippy::print_stdout, reason = "an example for a terminal")]

use std::path::Path;

use downbeat_scripts::{Choreography, Folder, Source, compile, read_fleet, render};

/// The choreography, or the findings as text.
fn compiled(fleet: &Path, scenario: &Path) -> Result<Choreography, String> {
    let (fleet, findings) = read_fleet(fleet);
    let fleet = fleet.ok_or_else(|| render(&findings, false))?;
    let source = Source::read(scenario).map_err(|finding| render(&[finding], false))?;
    // Files that the scenario names are read from its folder.
    let folder = Folder::new(scenario.parent().unwrap_or(Path::new("")).to_owned());
    let compiled = compile(&source, &fleet, &folder);
    compiled.choreography.ok_or_else(|| render(&compiled.findings, false))
}

fn main() -> Result<(), String> {
    let mut words = std::env::args().skip(1);
    let (fleet, scenario) = words.next().zip(words.next()).ok_or("compile FLEET SCENARIO")?;
    for act in compiled(Path::new(&fleet), Path::new(&scenario))?.acts {
        println!("{}", if act.name.is_empty() { "the only act" } else { &act.name });
        for robot in &act.plan.robots {
            for script in &robot.scripts {
                println!("  {} {}: {} steps", robot.robot, script.device, script.script.steps().len());
            }
        }
    }
    Ok(())
}
