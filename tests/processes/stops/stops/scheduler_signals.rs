//! Further signals to a scheduler, which are not in the matrix of stops.

use std::time::Duration;

use rustix::process::{Signal, kill_process};

use super::Way;
use super::cell::{check_row, stop};
use super::show::{Show, Trouble};

#[test]
fn sigquit_stops_every_robot_even_with_a_stalled_terminal_or_disk() {
    check_row(Way::Quit, &[Trouble::Nothing, Trouble::Terminal, Trouble::DiskStalled]);
}

#[test]
fn non_terminating_signals_do_not_end_a_mission() {
    let mut show = Show::begin(Trouble::Nothing);
    for signal in [Signal::USR1, Signal::USR2, Signal::XFSZ, Signal::PIPE] {
        kill_process(show.pid, signal).unwrap();
        for robot in &show.stage.robots {
            robot.await_sets(robot.sets().len() + 2, Duration::from_secs(20));
        }
    }
    let stopped = stop(&mut show, Way::Terminate);
    assert_eq!(stopped.code, Some(3), "{:?}", stopped.said);
}
