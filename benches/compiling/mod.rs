//! Helpers that the compiler benchmarks share: simulated robots, step counts and memory use.

use downbeat_scripts::{Address, Compiled, FleetRobot};

pub fn simulated(init: urrcp::InitializationBlock) -> FleetRobot {
    FleetRobot::new(init.id.clone(), Address::Simulated, Some(init))
}

/// Returns the number of steps in all scripts of all acts.
pub fn steps(compiled: &Compiled) -> usize {
    let acts = compiled.choreography.iter().flat_map(|choreography| &choreography.acts);
    let scripts = acts.flat_map(|act| &act.plan.robots).flat_map(|robot| &robot.scripts);
    scripts.map(|script| script.script.steps().len()).sum()
}

/// Peak resident memory of this process, in bytes.
pub fn peak_memory() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<usize>().ok());
    kilobytes.unwrap_or(0) * 1024
}
