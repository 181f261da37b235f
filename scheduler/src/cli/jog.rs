//! `downbeat jog`: moves the devices of one robot by hand, reads their positions back, and saves poses for scenarios.

mod hand;
mod keys;
mod screen;
mod sliders;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use downbeat_robot::{Host, HostOptions};
use downbeat_scripts::shown::shown;
use downbeat_scripts::{Fleet, FleetRobot, PoseDevice, did_you_mean, with_pose};
use serde_json::json;
use urrcp::{DeviceId, RobotId, Span};

use self::hand::{Hand, JogError};
use self::sliders::Slider;
use super::calibrate::{confirmed, part_of, refused, session, writable};
use super::drivers::DriverArgs;
use super::live::terminal;
use super::run::parse_span;
use super::{Exit, Format, ProjectArgs, console, identity, load};
use crate::fleet::{self, StartPrograms};
use crate::show::table::Rows;
use crate::signals::{OnHangUp, Signals};

/// Move the devices of a robot by hand, within their limits, and save poses for scenarios.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "On a terminal, a screen shows a slider for each device that takes positions. Without a terminal, or with --set or \
--save, the command moves the devices once, prints their positions, saves the pose and ends. The robot is reserved as in a mission. \
Devices move at no more than half of their maximum speed. At the end, and when you press Ctrl-C, they stay where they are.

A saved pose is a move. A scenario with `include: poses.yaml` plays it with `move: NAME`.

Examples:
  downbeat jog arm-1
  downbeat jog arm-1 --set elbow=45 --set wrist=-10 --yes --save ready=poses.yaml
  downbeat jog arm-1 --save here --format json"
)]
pub(super) struct JogArgs {
    /// The robot to move.
    robot: RobotId,
    /// The fleet file.
    #[arg(long, default_value = "fleet.yaml", value_name = "FILE")]
    fleet: PathBuf,
    #[command(flatten)]
    project: ProjectArgs,
    /// Move this device to this position, in its unit. All devices move together.
    #[arg(long, value_parser = setting, value_name = "DEVICE=VALUE", allow_hyphen_values = true)]
    set: Vec<Setting>,
    /// Save the positions as a pose of this name, in FILE or in the file of --poses.
    #[arg(long, value_parser = destination, value_name = "NAME[=FILE]")]
    save: Option<Destination>,
    /// The file to which poses are saved. By default, poses.yaml next to the fleet file.
    #[arg(long, value_name = "FILE")]
    poses: Option<PathBuf>,
    /// Do not ask before devices are moved by --set.
    #[arg(long)]
    yes: bool,
    /// How long to wait for an answer of the robot.
    #[arg(long, value_parser = parse_span, default_value = "5s", value_name = "TIME")]
    patience: Span,
    #[command(flatten)]
    drivers: DriverArgs,
}

/// A device and its new position.
#[derive(Clone, Debug)]
struct Setting {
    device: String,
    to: f64,
}

/// The name of a pose and the file that it is saved to. `None`: the file of `--poses`.
#[derive(Clone, Debug)]
struct Destination {
    name: String,
    file: Option<PathBuf>,
}

fn setting(text: &str) -> Result<Setting, String> {
    let expected = || "expected a device and its position, as in elbow=45".to_owned();
    let (device, to) = text.rsplit_once('=').ok_or_else(expected)?;
    let to = to.trim().parse().ok().filter(|to: &f64| to.is_finite()).ok_or_else(expected)?;
    Ok(Setting { device: device.trim().to_owned(), to })
}

fn destination(text: &str) -> Result<Destination, String> {
    let (name, file) = text.split_once('=').map_or((text, None), |(name, file)| (name, Some(file)));
    // An invalid name is reported before anything moves.
    with_pose(None, name, &[]).map_err(|error| error.to_string())?;
    match file {
        Some("") => Err("expected a file after `=`, as in ready=poses.yaml".to_owned()),
        file => Ok(Destination { name: name.to_owned(), file: file.map(PathBuf::from) }),
    }
}

pub(super) fn jog(args: &JogArgs, format: Format) -> Exit {
    let fleet = match load::load_fleet(&args.fleet, &args.project, format) {
        Ok(fleet) => fleet,
        Err(exit) => return exit,
    };
    let Some(robot) = fleet.robots.iter().find(|robot| robot.id == args.robot) else {
        let known = fleet.robots.iter().map(|robot| robot.id.as_str());
        let hint =
            did_you_mean(args.robot.as_str(), known).map(|hint| format!("; {hint}")).unwrap_or_default();
        return usage(&format!(
            "unknown robot `{}`: it is not in {}{hint}",
            args.robot,
            args.fleet.display()
        ));
    };
    let sliders = sliders::of(robot);
    if sliders.is_empty() {
        let robot = &args.robot;
        return usage(&format!(
            "no device of `{robot}` takes scripts of positions, so none can be moved by hand"
        ));
    }
    let targets = match targets(args, &sliders) {
        Ok(targets) => targets,
        Err(reason) => return usage(&reason),
    };
    let save = args.save.as_ref().map(|save| SaveAs {
        name: save.name.clone(),
        path: save.file.clone().unwrap_or_else(|| poses_path(args)),
    });
    if let Some(Err(reason)) = save.as_ref().map(SaveAs::check) {
        return usage(&reason);
    }
    if !targets.is_empty() && !args.yes {
        match confirmed() {
            Some(true) => {}
            Some(false) => return Exit::Done,
            None => {
                return usage(
                    "devices would move, but there is no terminal to ask for confirmation; add --yes if the movement is safe",
                );
            }
        }
    }
    let by_hand = targets.is_empty()
        && save.is_none()
        && format == Format::Text
        && terminal::has_keys()
        && terminal::can_draw();
    super::with_runtime(async {
        let work = Work { args, fleet: &fleet, robot, sliders, format };
        let ended = if by_hand { work.on_screen().await } else { work.once(&targets, save.as_ref()).await };
        ended.unwrap_or_else(|error| {
            console::error(&format!("{}: {error}", shown(args.robot.as_str())));
            Exit::Failed
        })
    })
}

fn usage(reason: &str) -> Exit {
    console::error(reason);
    Exit::Usage
}

fn poses_path(args: &JogArgs) -> PathBuf {
    args.poses.clone().unwrap_or_else(|| args.fleet.with_file_name("poses.yaml"))
}

/// Returns the wanted positions, or the reason why a device cannot take one.
fn targets(args: &JogArgs, sliders: &[Slider]) -> Result<BTreeMap<DeviceId, f64>, String> {
    let mut targets = BTreeMap::new();
    for Setting { device, to } in &args.set {
        let Some(slider) = sliders.iter().find(|slider| slider.device.as_str() == device) else {
            let known = || sliders.iter().map(|slider| slider.device.as_str());
            let known: Vec<_> = known().map(|device| format!("`{}`", shown(device))).collect();
            let (device, robot) = (shown(device), &args.robot);
            return Err(format!(
                "`{robot}` has no device `{device}` to move; expected one of {}",
                known.join(", ")
            ));
        };
        if let Some(reason) = slider.refuses(*to) {
            return Err(format!("`{}` cannot be moved to {to}: {reason}", shown(device)));
        }
        if targets.insert(slider.device.clone(), *to).is_some() {
            return Err(format!(
                "--set names `{}` twice; expected one position for each device",
                shown(device)
            ));
        }
    }
    Ok(targets)
}

/// The pose to save, and its file.
struct SaveAs {
    name: String,
    path: PathBuf,
}

impl SaveAs {
    /// Checks, before anything moves, that the file can be written.
    fn check(&self) -> Result<(), String> {
        self.text(&[])?;
        writable(&self.path)
    }

    fn text(&self, pose: &[PoseDevice]) -> Result<String, String> {
        let file = match fs::read_to_string(&self.path) {
            Ok(text) => Some(text),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
            Err(error) => return Err(format!("cannot read {}: {error}", self.path.display())),
        };
        with_pose(file.as_deref(), &self.name, pose)
            .map_err(|error| format!("cannot save to {}: {error}", self.path.display()))
    }

    fn write(&self, pose: &[PoseDevice]) -> Result<(), String> {
        let part = part_of(&self.path);
        let text = self.text(pose)?;
        let written = fs::write(&part, text).and_then(|()| fs::rename(&part, &self.path));
        written.map_err(|error| refused(&self.path, &error))
    }
}

/// One run of the command.
struct Work<'a> {
    args: &'a JogArgs,
    fleet: &'a Fleet,
    robot: &'a FleetRobot,
    sliders: Vec<Slider>,
    format: Format,
}

/// A robot that is reserved for this command.
struct Reserved<'a> {
    hand: Hand<'a>,
    /// The host of the robot, if this process drives it.
    host: Option<Host>,
    signals: Signals,
}

impl<'a> Work<'a> {
    /// Connects to the robot and reserves it. `None` if a signal came first.
    async fn reserve(&self) -> Result<Option<Reserved<'a>>, JogError> {
        let mut signals = Signals::listen(OnHangUp::End)
            .map_err(|error| JogError::Setup(format!("cannot install signal handlers: {error}")))?;
        let site = identity::site(self.fleet).map_err(JogError::Setup)?;
        let drivers = self.args.drivers.of(StartPrograms::Yes);
        let handshake = self.fleet.handshake;
        let options = HostOptions::default();
        let (host, endpoints) = fleet::endpoints_at_once(&[self.robot], handshake, &site, options, drivers)
            .map_err(|error| JogError::Setup(error.to_string()))?;
        let endpoint = endpoints.into_iter().next();
        let endpoint = endpoint.ok_or_else(|| JogError::Setup("the robot has no address".to_owned()))?;
        let session = session("jog").map_err(JogError::Setup)?;
        let begun = async {
            if let Some(host) = &host {
                fleet::await_hardware(host, drivers).await;
            }
            Hand::begin(self.fleet, self.robot, endpoint, session, self.args.patience).await
        };
        let hand = tokio::select! {
            begun = begun => begun?,
            _ = signals.next() => return Ok(None),
        };
        Ok(Some(Reserved { hand, host, signals }))
    }

    /// Moves the devices to `targets`, prints where they are, and saves the pose.
    async fn once(
        mut self,
        targets: &BTreeMap<DeviceId, f64>,
        save: Option<&SaveAs>,
    ) -> Result<Exit, JogError> {
        let Some(mut reserved) = self.reserve().await? else { return Ok(Exit::Stopped) };
        let moved = tokio::select! {
            moved = reserved.hand.bring(&mut self.sliders, targets) => moved.map(|()| Exit::Done),
            _ = reserved.signals.next() => Ok(Exit::Stopped),
        };
        let exit = release(reserved, moved).await?;
        if exit != Exit::Done {
            return Ok(exit);
        }
        let saved = save.map(|save| save.write(&sliders::pose(&self.sliders)));
        self.print(save.filter(|_| saved == Some(Ok(()))));
        match saved {
            Some(Err(reason)) => {
                console::error(&reason);
                Ok(Exit::Unwritten)
            }
            _ => Ok(Exit::Done),
        }
    }

    /// Lets the operator move the devices until they leave.
    async fn on_screen(self) -> Result<Exit, JogError> {
        let Some(mut reserved) = self.reserve().await? else { return Ok(Exit::Stopped) };
        let path = poses_path(self.args);
        let ended = screen::operate(&mut reserved, self.robot, self.sliders, &path).await;
        release(reserved, ended).await
    }

    fn print(&self, saved: Option<&SaveAs>) {
        if self.format == Format::Json {
            let devices = self.sliders.iter().map(|slider| {
                json!({"device": slider.device, "unit": slider.unit, "position": slider.at, "reading": slider.reading})
            });
            let saved = saved.map(|save| json!({"pose": save.name, "file": save.path}));
            let devices: Vec<_> = devices.collect();
            console::print_json(&json!({"robot": self.robot.id, "devices": devices, "saved": saved}));
            return;
        }
        let mut table = Rows::new(&["device", "position", "reading", "from", "to"], 1);
        for slider in &self.sliders {
            let unit = slider.unit.as_deref().map(|unit| format!(" {unit}")).unwrap_or_default();
            let known = |value: Option<f64>| {
                value.map_or_else(|| "unknown".to_owned(), |value| format!("{value}{unit}"))
            };
            let reading = slider.reading.map_or_else(|| "-".to_owned(), |value| format!("{value}{unit}"));
            table.add([
                slider.device.to_string(),
                known(slider.at),
                reading,
                slider.limits.min_value.to_string(),
                slider.limits.max_value.to_string(),
            ]);
        }
        console::print(&table.text(console::columns()));
        if let Some(SaveAs { name, path }) = saved {
            console::note(&how_to_play(name, path));
        }
    }
}

/// Returns how a scenario uses a saved pose.
fn how_to_play(name: &str, path: &Path) -> String {
    let file = path.file_name().map(|file| file.to_string_lossy().into_owned()).unwrap_or_default();
    let path = path.display();
    format!("saved `{name}` to {path}; a scenario with `include: {file}` plays it with `move: {name}`")
}

/// Orders all devices that were moved to stay where they are, and ends the robot if this process drives it. Returns the exit code.
async fn release(mut reserved: Reserved<'_>, ended: Result<Exit, JogError>) -> Result<Exit, JogError> {
    let held = reserved.hand.hold().await;
    let mut unconfirmed: Vec<String> = held.err().map(|error| error.to_string()).into_iter().collect();
    if let Some(host) = reserved.host {
        unconfirmed.extend(host.stop().iter().map(ToString::to_string));
    }
    if unconfirmed.is_empty() {
        return ended;
    }
    if let Err(error) = ended {
        console::error(&error.to_string());
    }
    unconfirmed.iter().for_each(|reason| console::error(reason));
    console::note(
        "a device may still be moving; without contact to this program, its movement ends within 2 s",
    );
    Ok(Exit::Unconfirmed)
}

/// Interval between two messages that renew the leases of the robot.
const TICK: Duration = Duration::from_millis(100);
