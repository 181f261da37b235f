//! Runs only the state machine of a robot, without threads or a clock: plays a script of three steps in virtual time.
//!
//! `cargo run --example machine --no-default-features`
#![expect(clippy::print_stdout, reason = "an example for a terminal")]

use downbeat_robot::urrcp::{
    Command, ControlRequest, ControlType, Device, DeviceId, InitializationBlock, LimitError, Limits, Millis,
    Script, ScriptParameters, Setpoint, Span, Step, Timestamp,
};
use downbeat_robot::{Input, LinkId, Output, Robot};

/// Plays the script. Returns one line per event, with the time since the request.
pub fn play() -> Result<Vec<String>, LimitError> {
    let percent = Limits::new(0.0, 100.0, 1.0)?;
    let lamp = DeviceId::new("lamp")?;
    let device = Device::new(lamp.clone())
        .with_position(percent.clone())
        .with_scripts(ScriptParameters::new(percent, 100));
    let mut block = InitializationBlock::new("stage-1".parse()?, vec![device])?;
    block.reports = true;
    let mut robot = Robot::new(block);

    let steps = [(0.0, 20.0), (250.0, 60.0), (500.0, 100.0)]
        .map(|(at, value)| Ok(Step::new(Millis::new(at)?, Setpoint::new(ControlType::Position, value))));
    let script = Script::new(steps.into_iter().collect::<Result<_, LimitError>>()?)?;
    let sent = Timestamp::from_nanos(1_700_000_000_000_000_000);
    // The script starts one second after the request.
    let request = ControlRequest::deferred(sent, Millis::new(1_000.0)?, lamp, Command::Script(script));

    let begin = sent.assume_clock();
    let (mut told, mut outputs) = (Vec::new(), Vec::new());
    robot.handle(begin, LinkId(0), Input::Message(request.into()), &mut outputs);
    let mut now = begin;
    loop {
        told.extend(outputs.drain(..).filter_map(|output| line(now - begin, &output)));
        let Some(next) = robot.next_wakeup() else { return Ok(told) };
        // A real robot would sleep until `next`, or until a message arrives.
        now = next;
        robot.advance(now, &mut outputs);
    }
}

fn line(since: Span, output: &Output) -> Option<String> {
    match output {
        Output::Set(set) => Some(format!("{since}: set {} {:?}", set.device, set.motion)),
        Output::Send { message: downbeat_robot::urrcp::Message::ControlResponse(response), .. } => {
            Some(format!("{since}: says {}", response.status))
        }
        _ => None,
    }
}

fn main() -> Result<(), LimitError> {
    play()?.iter().for_each(|line| println!("{line}"));
    Ok(())
}
