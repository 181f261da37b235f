//! Converts a fixture of the Open Fixture Library to an initialization block: one device for each channel of a mode.

mod capability;
mod channels;
mod device;
mod matrix;
mod parts;
mod read;
mod text;

use std::path::Path;

use downbeat_reader::fields::{At, Reader};
use downbeat_yaml::finding::{Code, did_you_mean};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::Source;

use self::device::{Device, Told};
use self::read::Fixture;
use super::description::{DescriptionOutcome, block_path, check_kind};
use super::fleet_part::FilePart;
use super::sink::Sink;
use super::tree;

/// Maximum size of a fixture file, in bytes. The largest file of the Open Fixture Library has 102 KB.
const BYTES_MAX: usize = 2 << 20;
/// Number of channels in a universe, which is also the maximum number of channels of a mode.
const CHANNELS_MAX: usize = 512;
/// Maximum number of modes that a finding lists. Most fixtures have fewer, but some have more than a hundred.
const MODES_LISTED_MAX: usize = 30;
/// The assumed number of steps of a script. It depends on the driver, not on the fixture.
const STEPS: usize = 512;
/// The assumed number of scripts that a device holds.
const QUEUE: usize = 2;

/// A fixture in one of its modes.
struct Robot {
    id: String,
    name: String,
    manufacturer: Option<String>,
    version: Option<String>,
    mode: String,
    channels: usize,
    devices: Vec<Device>,
}

/// Converts a fixture of the Open Fixture Library to an initialization block.
///
/// `mode` is the name or the short name of the mode. If it is `None`, the fixture must have only one mode. `id` is the id of the robot;
/// if it is `None`, the id is derived from the fixture's name.
#[must_use]
pub fn fixture(source: &Source, mode: Option<&str>, id: Option<&str>) -> DescriptionOutcome {
    let mut sink = Sink::default();
    let robot = converted(source, mode, id, &mut sink);
    let Some(robot) = robot.filter(|_| sink.findings.is_empty()) else {
        return DescriptionOutcome::refused(sink);
    };
    let path = block_path(&robot.id);
    let files = vec![
        FilePart { path: path.clone(), text: text::block(&robot, &source.name) },
        FilePart { path: "fleet.yaml".into(), text: text::fleet(&robot, &path) },
    ];
    DescriptionOutcome { files, devices: robot.devices.len(), notes: sink.notes, findings: sink.findings }
}

fn converted(source: &Source, mode: Option<&str>, id: Option<&str>, sink: &mut Sink) -> Option<Robot> {
    if source.text.len() > BYTES_MAX {
        let message = format!("the file has {} bytes", source.text.len());
        sink.about(&source.name, Code::ImportLimit, message, &format!("at most {BYTES_MAX} bytes"), None);
        return None;
    }
    if let Some(id) = id {
        check_kind(id, source, sink);
    }
    tree::read_json(source, sink, |root, findings, sink| {
        let fixture = read::fixture(root, findings)?;
        let index = selected(&fixture, mode, root, findings)?;
        let channels = fixture.channels(index, root, findings)?;
        let mut told = Told::default();
        let devices = device::devices(&fixture, &channels, &mut told);
        if devices.is_empty() {
            let message = format!("the mode `{}` has no channels", shortened(&fixture.modes[index].name));
            let place = read::mode_place(root, index);
            findings.add(Code::NothingToDo, place, message, "at least one channel", None);
            return None;
        }
        told.note(&source.name, sink);
        let id = id.map_or_else(|| device::slug(&fixture.name, "fixture"), str::to_owned);
        let folder = Path::new(&source.name).parent().and_then(Path::file_name);
        let folder = folder.map(|folder| folder.to_string_lossy().into_owned());
        Some(Robot {
            id,
            name: fixture.name,
            manufacturer: fixture.manufacturer.or(folder),
            version: fixture.version,
            mode: fixture.modes[index].name.clone(),
            channels: channels.len(),
            devices,
        })
    })
}

/// Returns the index of the mode with this name or short name, or of the only mode. Otherwise adds a finding that lists all modes.
fn selected(fixture: &Fixture, wanted: Option<&str>, root: &At<'_>, findings: &mut Reader) -> Option<usize> {
    let modes = &fixture.modes;
    let index = match wanted {
        None => (modes.len() == 1).then_some(0),
        Some(wanted) => {
            let by_name = modes.iter().position(|mode| mode.name == wanted);
            by_name.or_else(|| modes.iter().position(|mode| mode.short_name.as_deref() == Some(wanted)))
        }
    };
    if index.is_some() {
        return index;
    }
    let message = match wanted {
        None => format!("the fixture has {} modes", modes.len()),
        Some(wanted) => format!("no mode `{}`", shortened(wanted)),
    };
    let listed = modes.iter().take(MODES_LISTED_MAX).enumerate().map(|(index, mode)| {
        format!("`{}` ({})", shortened(&mode.name), channels_counted(fixture.count(index)))
    });
    let mut listed = listed.collect::<Vec<_>>().join(", ");
    if modes.len() > MODES_LISTED_MAX {
        listed.push_str(&format!(" and {} more", modes.len() - MODES_LISTED_MAX));
    }
    let names =
        modes.iter().flat_map(|mode| [Some(mode.name.as_str()), mode.short_name.as_deref()]).flatten();
    let hint = wanted.and_then(|wanted| did_you_mean(wanted, names));
    let hint = hint.unwrap_or_else(|| "select a mode with `--mode NAME`".to_owned());
    let expected = format!("one mode: {listed}");
    findings.add(Code::ImportNames, read::modes_place(root), message, expected, Some(hint));
    None
}

fn channels_counted(count: usize) -> String {
    downbeat_yaml::render::counted(count, "channel")
}
