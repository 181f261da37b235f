//! `downbeat check --watch` in a terminal next to an editor.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use stage::Process;
use stage::session::program;

use crate::{SHOW, desk};

#[track_caller]
fn await_line(lines: &Receiver<String>, part: &str) {
    while !lines
        .recv_timeout(Duration::from_secs(60))
        .unwrap_or_else(|_| panic!("no line with {part}"))
        .contains(part)
    {}
}

#[test]
fn scenario_is_checked_again_after_a_change() {
    let desk = desk();
    let folder = desk.path("");
    let mut command = Command::new(program());
    command.args(["check", "show.yaml", "--watch"]).current_dir(&folder);
    let mut check = Process(command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap());
    let output = BufReader::new(check.0.stderr.take().unwrap());
    let (sender, lines) = channel();
    std::thread::spawn(move || output.lines().map_while(Result::ok).try_for_each(|line| sender.send(line)));
    await_line(&lines, "waiting for a change");
    std::fs::write(desk.path("show.yaml"), SHOW.replace("robots: left", "robots: lift")).unwrap();
    await_line(&lines, "DB0008");
    await_line(&lines, "waiting for a change");
    std::fs::write(desk.path("moves.yaml"), "moves: {}\n").unwrap();
    await_line(&lines, "DB0023");
}
