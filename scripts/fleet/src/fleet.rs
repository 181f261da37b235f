//! The fleet file: the robots, their addresses, and their descriptions.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use urrcp::{ControlType, Device, DeviceId, InitializationBlock, RobotId, Span};

use crate::address::{ADDRESS, Address, address_fault};
use crate::init::{Init, read_supplements};
use crate::kinds;
use downbeat_reader::fields::{At, Reader};
use downbeat_reader::keys::{Declaration, Item, Keys, Kind, Naming};
use downbeat_reader::slips::{self, Units};
use downbeat_reader::{keys, schema, words};
use downbeat_space::space::{Body, Space};
use downbeat_yaml::composed::composed;
use downbeat_yaml::duration::written;
use downbeat_yaml::finding::{Code, Finding, PathStep, Place, Severity};
use downbeat_yaml::home::expand_home;
use downbeat_yaml::identify::{self, Document};
use downbeat_yaml::locate::locate;
use downbeat_yaml::node::{self, Node};
use downbeat_yaml::project::{Project, folder_of};
use downbeat_yaml::shown::shortened;
use downbeat_yaml::source::{Source, is_general};
use downbeat_yaml::syntax::conceal;
use downbeat_yaml::tags::foreign_tags;

mod apart;
mod body;
mod calibration;
mod declared;
mod drive;
mod joints;
mod latency;
mod mission_settings;
mod moves;
mod sensors;
mod universes;
mod urdf;

use crate::init::DeviceKeys;
use body::{BodyKeys, SpaceKeys};
use calibration::CalibrateKeys;
pub use calibration::{Calibration, Taken};
use declared::device_named;
pub use declared::{devices_of, limits_of, settable_limits};
use latency::LatencyKeys;
pub use latency::{
    DeviceLatency, LAGS_MAX, Lag, LatencyFile, LatencySource, MeasuredLatency, latency_file_of, latency_keys,
    latency_text, read_latency_file,
};
use mission_settings::RangeKeys;
pub use mission_settings::{ClockMode, MissionSettings, Requirement};
use moves::MovesKeys;
pub use moves::SimulatedMoves;
pub use sensors::sensor;

/// The index that the place of a finding has if it is in the file of measured latencies. Index 0 stands for the fleet file.
const LATENCY_FILE: u16 = 1;
const HANDSHAKE_WORDS: [(&str, Handshake); 2] = [("full", Handshake::Full), ("skip", Handshake::Skip)];
const FAULT_WORDS: [(&str, Fault); 3] =
    [("refuse", Fault::Refuse), ("silent", Fault::Silent), ("disconnect", Fault::Disconnect)];

keys! {
    /// The robots of a site, and how they are reached.
    pub(crate) struct FleetKeys {
        /// NTP server, `host` or `host:port`; without it, the system's clock is trusted.
        ntp: schema!({"type": ["string", "null"]}),
        /// Whether robots must identify themselves.
        handshake: words!(HANDSHAKE_WORDS),
        /// The operator's key and certificate, for robots with `tls://` and `hmac://` addresses: a file that `downbeat keys
        /// operator` writes. `~/` stands for your home folder.
        identity: kinds::TEXT,
        /// The list of revoked certificates, which `downbeat keys` writes. `~/` stands for your home folder.
        revoked: kinds::TEXT,
        /// The Zenoh configuration for robots with `zenoh:` addresses. `~/` stands for your home folder.
        zenoh: kinds::TEXT,
        /// Permits plain TCP to other machines: for a dedicated network.
        insecure: kinds::BOOLEAN,
        /// The file of measured latencies, which `downbeat calibrate` writes.
        latency: kinds::FILE,
        space: SpaceKeys::KIND,
        /// Robots by id.
        #[required]
        robots: Kind::NameKeys(Naming::Defines(Item::Robot), &Kind::SomeEntries(&RobotKeys::KIND)),
        /// Names for groups of robots.
        groups: Kind::NameKeys(Naming::Defines(Item::Robot), &Kind::Entries(&Kind::Name(Naming::Uses(Item::Robot), &Kind::List(&kinds::NAME, 0..=usize::MAX)))),
    }
}

keys! {
    /// A robot.
    pub(crate) struct RobotKeys as "robot" {
        /// Its initialization block, a YAML or JSON file, relative to the folder of this file.
        #[required]
        init: kinds::FILE,
        /// Values that the description of a Thrift robot lacks, by device id.
        devices: Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&DeviceKeys::KIND)),
        /// `sim`, tls://host:port, hmac://host:port, tcp://host:port, sacn:UNIVERSE/CHANNEL, artnet:UNIVERSE/CHANNEL@host, osc:host:port/path, mavlink:udp:host:port, thrift://host:port or program:COMMAND.
        #[required]
        address: schema!({"type": "string", "pattern": "^(sim|(tcp|tls|hmac)://.+:\\d+|thrift://.+:\\d+(\\?id=.+)?|zenoh:.+|(sacn|artnet):\\d+/\\d+.*|osc:.+:\\d+.*|mavlink:udp:.+:\\d+.*|program:.*\\S.*)$"}),
        /// The `id` that the robot itself declares, if that differs from its name here.
        robot_id: schema!({"type": "string", "minLength": 1, "maxLength": 256}),
        simulate: SimulateKeys::KIND,
        /// The largest speed and acceleration of devices, by device id.
        limits: Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&LimitKeys::KIND)),
        /// `ntp`: the robot follows NTP, which is only verified. `measured`: messages to it are converted to its own time.
        clock: words!(mission_settings::CLOCK_WORDS),
        /// The largest delay with which it wakes up for a start.
        wake_up: kinds::TIME,
        /// The time from a command to visible motion: one time for all devices that take commands, or one per device.
        latency: Kind::AnyOf(&[&kinds::TIME, &Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&Kind::AnyOf(&[&kinds::TIME, &LatencyKeys::KIND])))]),
        /// The required readings of its sensors before a mission, by sensor.
        require: Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&Kind::AnyOf(&[&schema!({"type": "string", "pattern": "^\\s*(above|below)\\s+\\S+\\s*$"}), &RangeKeys::KIND]))),
        /// The encoding of messages to it over TCP. It must list `msgpack`, which is much smaller than JSON, in its initialization block.
        encoding: Kind::Words(&["json", "msgpack"]),
        body: BodyKeys::KIND,
        /// How `downbeat calibrate` may move its devices, by device id.
        calibrate: Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&CalibrateKeys::KIND)),
    }
}

keys! {
    /// Limits.
    pub(crate) struct LimitKeys {
        /// In the device's unit per second.
        speed: kinds::POSITIVE,
        /// In the device's unit per second squared.
        acceleration: kinds::POSITIVE,
    }
}

keys! {
    /// How a simulated robot differs from a perfect one.
    pub(crate) struct SimulateKeys as "simulate" {
        /// Its raw clock minus the true time.
        clock_offset: kinds::SIGNED_TIME,
        /// How much faster its clock runs, such as `5ppm`.
        drift: schema!({"type": "string", "pattern": "^-?\\d+(\\.\\d+)?\\s*ppm$"}),
        /// Largest random error of the times that it reports.
        jitter: kinds::TIME,
        /// The accuracy with which NTP measures its clock; `none`: it has no NTP.
        ntp_error: Kind::AnyOf(&[&kinds::TIME, &schema!({"const": "none"})]),
        /// Least and largest delay of every message, in each direction.
        delay: Kind::List(&kinds::TIME, 2..=2),
        /// A fault of the robot.
        fault: words!(FAULT_WORDS),
        /// The readings of its sensors, by device id, in their units. Other sensors have no readings.
        readings: Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&kinds::PLAIN_NUMBER)),
        /// How its body follows its devices, by device id. Without it, the body follows immediately.
        moves: Kind::NameKeys(Naming::Uses(Item::Device), &Kind::Entries(&MovesKeys::KIND)),
    }
}

/// All robots of a site, with the settings of the fleet file.
#[derive(Clone, Debug, Default)]
pub struct Fleet {
    /// NTP server, `host` or `host:port`. `None` if the system's clock is trusted.
    pub ntp: Option<String>,
    /// Whether robots must identify themselves.
    pub handshake: Handshake,
    /// The path of the file with the operator's key and certificate, for robots with `tls://` and `hmac://` addresses. `None` if the
    /// fleet file contains no path.
    pub identity: Option<PathBuf>,
    /// The path of the list of revoked certificates. `None` if the fleet file contains no path.
    pub revoked: Option<PathBuf>,
    /// The path of the configuration of the Zenoh network, for robots with `zenoh:` addresses. `None` if the fleet file contains no path.
    pub zenoh: Option<PathBuf>,
    /// Requirements on the space that all robots share.
    pub space: Space,
    /// The robots, in the order of the file.
    pub robots: Vec<FleetRobot>,
    /// The robots of each group, by the name of the group.
    pub groups: BTreeMap<String, Vec<RobotId>>,
}

/// Returns the declaration of the keys of fleet files.
#[must_use]
pub fn fleet_keys() -> &'static Declaration {
    FleetKeys::declaration()
}

/// Whether the handshake, steps 1 to 4 of the protocol, is performed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Handshake {
    /// All robots must identify themselves.
    #[default]
    Full,
    /// No handshake: the initialization blocks in files are trusted instead.
    Skip,
}

/// One robot of the fleet file.
#[derive(Clone, Debug)]
pub struct FleetRobot {
    /// The key of the robot in the fleet file.
    pub id: RobotId,
    /// The address of the robot.
    pub address: Address,
    /// The initialization block of the robot. Its id is the one that the robot declares: `robot_id`, or else the key in the fleet file.
    /// `None` if the block is not known.
    pub init: Option<InitializationBlock>,
    /// The behaviour of the robot in simulation.
    pub simulation: SimulationSettings,
    /// The largest speed and acceleration of the robot's devices, by device id, if they are lower than the declared limits.
    pub limits: BTreeMap<String, RateLimits>,
    /// The body of the robot, which relates its devices to space. `None` if the fleet file describes no body.
    pub body: Option<Body>,
    /// The robot's other properties that a mission uses.
    pub mission: MissionSettings,
}

impl FleetRobot {
    /// Creates a robot with the given properties. All other properties have the defaults of the fleet file.
    #[must_use]
    pub fn new(id: RobotId, address: Address, init: Option<InitializationBlock>) -> Self {
        Self {
            id,
            address,
            init,
            simulation: SimulationSettings::default(),
            limits: BTreeMap::new(),
            body: None,
            mission: MissionSettings::default(),
        }
    }
}

/// Limits of a device's motion: upper bounds of the derivatives of its value. A limit is `None` if it is not known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RateLimits {
    /// Limit of the first derivative, in the device's unit per second: the speed if the value is a position.
    pub speed: Option<f64>,
    /// Limit of the second derivative, in the device's unit per second squared: the acceleration if the value is a position.
    pub acceleration: Option<f64>,
}

impl RateLimits {
    /// Replaces missing limits by those that the device declares for the control types speed and acceleration: the larger of
    /// `|min_value|` and `|max_value|`. If the device is driven by speed, the first derivative of its value is an acceleration.
    #[must_use]
    pub fn or_declared(self, device: &Device, control_type: ControlType) -> Self {
        let declared = |rate| {
            let limits = device.available_control_types.limits(rate)?;
            Some(limits.min_value.abs().max(limits.max_value.abs()))
        };
        let (speed, acceleration) = (
            self.speed.or_else(|| declared(ControlType::Speed)),
            self.acceleration.or_else(|| declared(ControlType::Acceleration)),
        );
        match control_type {
            ControlType::Position => Self { speed, acceleration },
            ControlType::Speed => Self { speed: acceleration, acceleration: None },
            _ => Self::default(),
        }
    }
}

/// How a simulated robot differs from a perfect one.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulationSettings {
    /// The offset of the robot's raw clock: its time minus the true time.
    pub clock_offset: Span,
    /// How much faster the raw clock runs than true time, in parts per million.
    pub drift_ppm: f64,
    /// Largest random error of the times that the robot reports.
    pub jitter: Span,
    /// The accuracy with which NTP measures the raw clock. `None` if the robot has no NTP.
    pub ntp_error: Option<Span>,
    /// Least and largest delay of every message, in each direction. `None` if the fleet file states no delay.
    pub delay: Option<(Span, Span)>,
    /// The fault of the robot, if any.
    pub fault: Option<Fault>,
    /// The readings of the robot's sensors, in their units. Other sensors have no readings.
    pub readings: Vec<(DeviceId, f64)>,
    /// How the robot's body follows its devices. The body immediately follows devices that are not listed.
    pub moves: Vec<SimulatedMoves>,
}

impl Default for SimulationSettings {
    fn default() -> Self {
        Self {
            clock_offset: Span::ZERO,
            drift_ppm: 0.0,
            jitter: Span::ZERO,
            ntp_error: Some(Span::ZERO),
            delay: None,
            fault: None,
            readings: Vec::new(),
            moves: Vec::new(),
        }
    }
}

/// A fault of a simulated robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The robot refuses every script.
    Refuse,
    /// The robot never responds to a control request.
    Silent,
    /// The robot closes the connection after it has accepted a script.
    Disconnect,
}

/// Reads a fleet file that the user has specified, and the files to which it refers. These files must be in the project of the fleet file
/// ([`Project::of`]). Returns the findings in all files together, and the fleet only if there are no errors.
#[must_use]
pub fn read_fleet(path: &Path) -> (Option<Fleet>, Vec<Finding>) {
    read_fleet_within(path, &Project::of(path))
}

/// Like [`read_fleet`], but the files to which the fleet file refers must be in the given project.
#[must_use]
pub fn read_fleet_within(path: &Path, project: &Project) -> (Option<Fleet>, Vec<Finding>) {
    of_source(path, Source::read(path), project)
}

/// Like [`read_fleet_within`], for a fleet whose latencies are about to be measured: its latency file may be missing.
#[must_use]
pub fn read_fleet_to_measure(path: &Path, project: &Project) -> (Option<Fleet>, Vec<Finding>) {
    read_with(path, Source::read(path), project, Latencies::Awaited)
}

/// Like [`read_fleet_within`], for a fleet file that a scenario names. The fleet file must be in the project, too.
#[must_use]
pub fn read_fleet_named(path: &Path, project: &Project) -> (Option<Fleet>, Vec<Finding>) {
    of_source(path, project.read(path), project)
}

/// Whether the file of measured latencies must exist.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Latencies {
    Measured,
    Awaited,
}

fn of_source(
    path: &Path,
    source: Result<Source, Finding>,
    project: &Project,
) -> (Option<Fleet>, Vec<Finding>) {
    read_with(path, source, project, Latencies::Measured)
}

fn read_with(
    path: &Path,
    source: Result<Source, Finding>,
    project: &Project,
    awaited: Latencies,
) -> (Option<Fleet>, Vec<Finding>) {
    let source = match source {
        Ok(source) => source,
        Err(mut finding) => {
            // A misspelt name already has its hint.
            finding.hint.get_or_insert_with(|| {
                "a fleet file lists your robots: run `downbeat init` to create one".to_owned()
            });
            return (None, vec![finding]);
        }
    };
    let document = match node::parse(&source) {
        Ok(document) => document,
        Err(finding) => return (None, vec![conceal(finding, &source, FleetKeys::NAMES)]),
    };
    let mistaken = identify::mistaken_by_keys(&source, &document, Document::Fleet, FleetKeys::NAMES);
    if let Some(mistaken) = mistaken {
        return (None, vec![mistaken]);
    }
    let tags = foreign_tags(&source);
    if !tags.is_empty() {
        return (None, tags);
    }
    let mut reader = FleetReader {
        folder: folder_of(path).to_path_buf(),
        project,
        awaited,
        inits: HashMap::new(),
        urdfs: urdf::Urdfs::new(folder_of(path), project.clone()),
        latencies: LatencyFile::new(),
        sources: vec![source],
        findings: Reader::default(),
        elsewhere: Vec::new(),
    };
    let fleet = reader.fleet(&At::document(&document, 0));
    let mut findings = locate(&reader.sources, reader.findings.finish());
    findings.append(&mut reader.elsewhere);
    findings.append(&mut reader.urdfs.elsewhere);
    let sound = findings.iter().all(|finding| finding.severity == Severity::Warning);
    (fleet.filter(|_| sound), findings)
}

struct FleetReader<'a> {
    folder: PathBuf,
    project: &'a Project,
    awaited: Latencies,
    /// The robot descriptions read so far, by path, because many robots share a file.
    inits: HashMap<PathBuf, Option<Init>>,
    /// The URDF files of arms read so far.
    urdfs: urdf::Urdfs,
    /// The measured latencies of devices.
    latencies: LatencyFile,
    /// The fleet file, followed by the file with index [`LATENCY_FILE`] if there is one.
    sources: Vec<Source>,
    findings: Reader,
    /// Findings in files other than the fleet file and the latency file.
    elsewhere: Vec<Finding>,
}

impl FleetReader<'_> {
    fn fleet(&mut self, at: &At<'_>) -> Option<Fleet> {
        let FleetKeys { ntp, handshake, identity, revoked, zenoh, insecure, latency, space, robots, groups } =
            self.findings.keys(at, "the fleet file")?;
        let mut fleet = Fleet::default();
        if let Some(ntp) = ntp.filter(|at| *at.node != Node::Null) {
            fleet.ntp = self.findings.text(&ntp, "the name of an NTP server").map(Into::into);
        }
        if let Some(handshake) = handshake {
            fleet.handshake = self.findings.word(&handshake, &HANDSHAKE_WORDS).unwrap_or_default();
        }
        let mut file = |at: Option<At<'_>>, expected| {
            let path = at.and_then(|at| self.findings.text(&at, expected));
            path.map(|path| self.folder.join(expand_home(Path::new(path.as_ref()))))
        };
        fleet.identity = file(identity, "the path of an identity file, created by `downbeat keys operator`");
        fleet.revoked =
            file(revoked, "the path of a list of revoked certificates, created by `downbeat keys`");
        fleet.zenoh = file(zenoh, "the path of a Zenoh configuration file");
        let insecure = insecure.and_then(|at| self.findings.truth(&at)).unwrap_or(false);
        fleet.space = space.map(|at| body::read_space(&mut self.findings, &at)).unwrap_or_default();
        self.latencies = latency.map(|at| self.latency_file(&at)).unwrap_or_default();
        let robots = robots?;
        latency::warn_of_robots(&mut self.findings, LATENCY_FILE, &self.latencies, robots.node);
        let mut names: HashMap<String, &str> = HashMap::new();
        for (name, at) in
            self.findings.entries(&robots, "a map from each robot id to its address and init file")
        {
            if names.insert(composed(name).into_owned(), name).is_some() {
                self.same_name(name, &robots);
                continue;
            }
            if name == "groups"
                && matches!(at.node, Node::Map(keys) if keys.iter().all(|(key, _)| !RobotKeys::NAMES.contains(&key.as_str())))
            {
                let hint = Some("write `groups` at the same level as `robots`, not inside it".to_owned());
                let message = "`groups` is listed as a robot";
                self.findings.add(Code::UnknownKey, at.key_place(), message, "a robot", hint);
                continue;
            }
            let robot = self.robot(name, &at, fleet.handshake);
            fleet.robots.extend(robot);
        }
        if !insecure {
            apart::none_open(&mut self.findings, &robots, &fleet.robots);
        }
        apart::one_place_each(&mut self.findings, &robots, &fleet.robots);
        apart::none_crowded(&mut self.findings, &robots, &fleet.robots);
        universes::one_user_each(&mut self.findings, &robots, &fleet.robots);
        if fleet.robots.is_empty() && matches!(robots.node, Node::Map(entries) if entries.is_empty()) {
            self.findings.add(
                Code::NothingToDo,
                robots.place(),
                "the fleet has no robots",
                "at least one robot",
                None,
            );
        }
        if let Some(groups) = groups {
            // Groups may name robots that have findings of their own, so that one fault does not cause several findings.
            let Node::Map(named) = robots.node else { return Some(fleet) };
            let named = named.iter().map(|(name, _)| (composed(name).into_owned(), name.as_str())).collect();
            self.groups(&groups, &named, &mut fleet);
        }
        Some(fleet)
    }

    /// Reports two robots whose names look the same but are encoded differently.
    fn same_name(&mut self, name: &str, robots: &At<'_>) {
        let place = Place { key: true, ..robots.place().below(PathStep::Key(name.to_owned(), 1)) };
        let message = format!(
            "duplicate robot name `{}`: the letters look the same, but are encoded differently",
            shortened(name)
        );
        let hint = Some("rename one of them, or remove it".to_owned());
        self.findings.add(Code::DuplicateKey, place, message, "names that look different", hint);
    }

    fn robot(&mut self, name: &str, at: &At<'_>, handshake: Handshake) -> Option<FleetRobot> {
        let id = match RobotId::new(name) {
            Ok(id) => id,
            Err(error) => {
                let expected = "a robot id of 1 to 256 characters";
                self.findings.add(Code::WrongType, at.key_place(), error.to_string(), expected, None);
                return None;
            }
        };
        let what = format!("robot `{name}`");
        let keys: RobotKeys<'_> = self.findings.keys(at, &what)?;
        let address = keys.address.and_then(|at| self.address(&at));
        let mut init = keys.init.and_then(|at| self.init(&at, keys.devices.as_ref()))?;
        let simulation = keys.simulate.map(|at| self.simulation(&at, &init)).unwrap_or_default();
        let own_id = keys.robot_id.and_then(|at| self.own_id(&at));
        init.id = own_id.unwrap_or_else(|| id.clone());
        let limits = keys.limits.map(|at| self.limits(&at, &init)).unwrap_or_default();
        let body =
            keys.body.as_ref().and_then(|at| body::read_body(&mut self.findings, at, &init, &mut self.urdfs));
        let measured = self.latencies.get(&id);
        if let Some(measured) = measured {
            latency::warn_of_devices(&mut self.findings, LATENCY_FILE, &id, measured, &init);
        }
        let latencies = latency::read(&mut self.findings, &keys, &init, measured);
        let settings = mission_settings::read(&mut self.findings, &keys, &init, handshake);
        let calibrate = keys.calibrate.map(|at| calibration::read(&mut self.findings, &at, &init));
        let mission = MissionSettings { latencies, calibrate: calibrate.unwrap_or_default(), ..settings };
        let robot = FleetRobot::new(id, address?, Some(init));
        Some(FleetRobot { simulation, limits, body, mission, ..robot })
    }

    /// Reads the file of measured latencies that the fleet file names.
    fn latency_file(&mut self, at: &At<'_>) -> LatencyFile {
        let expected = "the path of a latency file, created by `downbeat calibrate`";
        let Some(path) = self.findings.text(at, expected) else { return LatencyFile::new() };
        let path = self.folder.join(path.as_ref());
        let source = match self.project.read(&path) {
            Ok(source) => source,
            Err(finding) if finding.code == Code::OutsideProject => {
                self.findings.add_named(at.place(), finding);
                return LatencyFile::new();
            }
            Err(_) if self.awaited == Latencies::Awaited && !path.exists() => return LatencyFile::new(),
            Err(finding) => {
                let message =
                    format!("cannot read the latency file `{}`: {}", path.display(), finding.message);
                let hint = finding.hint.filter(|hint| !is_general(hint)).unwrap_or_else(|| {
                    "run `downbeat calibrate` to create it; the path is relative to the folder of the fleet file"
                        .to_owned()
                });
                self.findings.add(Code::Unreadable, at.place(), message, "a readable file", Some(hint));
                return LatencyFile::new();
            }
        };
        match node::parse(&source) {
            Ok(document) => {
                self.sources.push(source);
                latency::read_file(&mut self.findings, &At::document(&document, LATENCY_FILE))
            }
            Err(finding) => {
                self.elsewhere.push(finding);
                LatencyFile::new()
            }
        }
    }

    /// Reads `robot_id`: the id that the robot itself declares, if it differs from the name in the fleet file.
    fn own_id(&mut self, at: &At<'_>) -> Option<RobotId> {
        let expected = "the id that the robot declares, of 1 to 256 characters";
        let text = self.findings.text(at, expected)?;
        let id = RobotId::new(text.as_ref());
        if let Err(wrong) = &id {
            self.findings.add(Code::WrongType, at.place(), wrong.to_string(), expected, None);
        }
        id.ok()
    }

    fn limits(&mut self, at: &At<'_>, init: &InitializationBlock) -> BTreeMap<String, RateLimits> {
        let mut limits = BTreeMap::new();
        self.findings.units = Units::of(&init.devices);
        if let Node::Map(entries) = at.node
            && !entries.is_empty()
            && entries
                .iter()
                .all(|(key, _)| LimitKeys::NAMES.contains(&key.as_str()) && init.device(key).is_none())
        {
            let device = init.devices.first().map_or("elbow", |device| device.id.as_str());
            let hint = Some(format!("name the device first, as in `limits: {{{device}: {{speed: 90}}}}`"));
            self.findings.add(
                Code::WrongType,
                at.place(),
                "missing device in the limits",
                "a map from each device to its limits",
                hint,
            );
            return limits;
        }
        for (device, at) in
            self.findings.entries(at, "a map from each device to its maximum speed and acceleration")
        {
            if device_named(init, device).is_none() {
                let known = || init.devices.iter().map(|device| device.id.as_str());
                let message = format!("the robot has no device `{}`", shortened(device));
                let expected = downbeat_yaml::finding::one_of(known());
                let hint = self.findings.did_you_mean(device, known());
                self.findings.add(Code::UnknownDevice, at.key_place(), message, expected, hint);
            }
            let Some(LimitKeys { speed, acceleration }) = self.findings.keys(&at, "limits") else {
                continue;
            };
            let expected = "a number above 0, in the device's unit";
            let mut positive = |at: Option<At<'_>>| at.and_then(|at| self.findings.positive(&at, expected));
            let rates = RateLimits { speed: positive(speed), acceleration: positive(acceleration) };
            let id = device_named(init, device).map_or(device, |device| device.id.as_str());
            limits.insert(id.to_owned(), rates);
        }
        limits
    }

    fn address(&mut self, at: &At<'_>) -> Option<Address> {
        let text = self.findings.text(at, ADDRESS)?;
        let address = text.parse().ok();
        if address.is_none() {
            let (fault, hint) = address_fault(&text);
            let message = format!("`{}` {fault}", shortened(&text));
            self.findings.add(Code::UnknownWord, at.place(), message, ADDRESS, hint);
        }
        address
    }

    fn init(&mut self, at: &At<'_>, devices: Option<&At<'_>>) -> Option<InitializationBlock> {
        let path = self.folder.join(self.findings.text(at, "the path of an initialization block")?.as_ref());
        if !self.inits.contains_key(&path) {
            let init = self.read_init(at, &path);
            self.inits.insert(path.clone(), init);
        }
        let init = self.inits.get(&path)?.as_ref()?;
        let supplements = match (devices, init) {
            (Some(at), Init::Dictionary(..)) => read_supplements(&mut self.findings, at, &init.devices()),
            (Some(at), Init::Block(..)) => {
                let message =
                    format!("the init file `{}` already describes its devices completely", path.display());
                let expected = "`devices` only for a robot with a Thrift description";
                let hint = Some("change the init file instead".to_owned());
                self.findings.add(Code::UnknownKey, at.key_place(), message, expected, hint);
                return None;
            }
            (None, _) => Vec::new(),
        };
        match init.block(&supplements) {
            Ok(block) => Some(block),
            Err(findings) => {
                // Robots that share a file also share its faults.
                let new = findings.into_iter().filter(|finding| !self.elsewhere.contains(finding));
                let new: Vec<_> = new.collect();
                self.elsewhere.extend(new);
                None
            }
        }
    }

    fn read_init(&mut self, at: &At<'_>, path: &Path) -> Option<Init> {
        match self.project.read(path) {
            Ok(source) => {
                let read = Init::read(source).map_err(|findings| self.elsewhere.extend(findings)).ok();
                if let Some(Init::Block(_, warnings)) = &read {
                    self.elsewhere.extend_from_slice(warnings);
                }
                read
            }
            Err(finding) if finding.code == Code::OutsideProject => {
                self.findings.add_named(at.place(), finding);
                None
            }
            Err(finding) => {
                let message = format!("cannot read the init file `{}`: {}", path.display(), finding.message);
                let hint = finding.hint.filter(|hint| !is_general(hint));
                let hint = hint.unwrap_or_else(|| match path.to_str().filter(|path| path.contains('\\')) {
                    Some(path) => {
                        format!("use `/` to separate folders: write `{}`", path.replace('\\', "/"))
                    }
                    None => "the path is relative to the folder of the fleet file".to_owned(),
                });
                self.findings.add(Code::Unreadable, at.place(), message, "a readable file", Some(hint));
                None
            }
        }
    }

    fn simulation(&mut self, at: &At<'_>, init: &InitializationBlock) -> SimulationSettings {
        let mut settings = SimulationSettings::default();
        let Some(keys) = self.findings.keys(at, "`simulate`") else { return settings };
        let SimulateKeys { clock_offset, drift, jitter, ntp_error, delay, fault, readings, moves } = keys;
        let findings = &mut self.findings;
        settings.clock_offset = clock_offset.and_then(|at| findings.signed_duration(&at)).unwrap_or_default();
        settings.drift_ppm = drift.and_then(|at| drift_ppm(findings, &at)).unwrap_or_default();
        settings.jitter = jitter.and_then(|at| findings.duration(&at)).unwrap_or_default();
        if let Some(at) = ntp_error {
            settings.ntp_error = match at.node {
                Node::Text(text) if text == "none" => None,
                _ => findings.duration(&at),
            };
        }
        settings.delay = delay.and_then(|at| delay_range(findings, &at));
        settings.fault = fault.and_then(|at| findings.word(&at, &FAULT_WORDS));
        settings.readings = readings.map(|at| self.readings(&at, init)).unwrap_or_default();
        settings.moves = moves.map(|at| moves::read(&mut self.findings, &at, init)).unwrap_or_default();
        settings
    }

    /// Reads the readings of a simulated robot's sensors, such as `{range: 0.4}`.
    fn readings(&mut self, at: &At<'_>, init: &InitializationBlock) -> Vec<(DeviceId, f64)> {
        let mut readings = Vec::new();
        for (name, at) in self.findings.entries(at, "a map from each sensor to its reading") {
            let reading = self.findings.number(&at, "a number, in the unit of the sensor");
            let sensor = sensor(&mut self.findings, name, &at, init);
            readings.extend(sensor.zip(reading));
        }
        readings
    }

    /// Reads the groups of robots. `named` maps each robot's name in Unicode normalization form C to its name in the file.
    fn groups(&mut self, at: &At<'_>, named: &HashMap<String, &str>, fleet: &mut Fleet) {
        let ids: HashMap<String, RobotId> = fleet
            .robots
            .iter()
            .map(|robot| (composed(robot.id.as_str()).into_owned(), robot.id.clone()))
            .collect();
        let mut sorted: Vec<&str> = named.values().copied().collect();
        sorted.sort_unstable();
        let entries = self.findings.entries(at, "a map from each group to the list of its robots");
        let groups: Vec<&str> = entries.iter().map(|(name, _)| *name).collect();
        for (name, at) in entries {
            if named.contains_key(composed(name).as_ref()) {
                let message = format!("the group `{name}` has the name of a robot");
                self.findings.add(Code::NameClash, at.key_place(), message, "a unique name", None);
            }
            let mut members = Vec::new();
            for item in self.findings.list(&at, "a list of robots") {
                let Some(id) = self.findings.name(&item, "the id of a robot") else { continue };
                match ids.get(composed(&id).as_ref()) {
                    Some(id) => members.push(id.clone()),
                    None if named.contains_key(composed(&id).as_ref()) => {}
                    None => unknown_robot(&mut self.findings, &item, &id, &sorted, &groups),
                }
            }
            fleet.groups.insert(composed(name).into_owned(), members);
        }
    }
}

fn unknown_robot(findings: &mut Reader, at: &At<'_>, name: &str, known: &[&str], groups: &[&str]) {
    let hint = if groups.contains(&name) {
        Some("a group contains robots, not groups: list the robots of this group".to_owned())
    } else {
        slips::several_names(name, known.iter().copied())
            .or_else(|| findings.did_you_mean(name, known.iter().copied()))
    };
    let message = format!("no robot or group `{}` in the fleet", shortened(name));
    let expected = downbeat_yaml::finding::one_of(known.iter().copied());
    findings.add(Code::UnknownRobot, at.place(), message, expected, hint);
}

/// Reads the drift of a clock, in parts per million.
pub fn drift_ppm(findings: &mut Reader, at: &At<'_>) -> Option<f64> {
    let expected = "a drift such as 5ppm";
    let text = findings.text(at, expected)?;
    let number = text.strip_suffix("ppm").and_then(|number| number.trim().parse::<f64>().ok());
    let number = number.filter(|ppm| ppm.abs() <= 100_000.0);
    if number.is_none() {
        findings.add(
            Code::UnknownWord,
            at.place(),
            format!("`{}` is not a drift", shortened(&text)),
            expected,
            None,
        );
    }
    number
}

fn delay_range(findings: &mut Reader, at: &At<'_>) -> Option<(Span, Span)> {
    let expected = "the minimum and maximum delay, such as [0ms, 80ms]";
    let items = findings.list(at, expected);
    let [least, largest] = items.as_slice() else {
        if matches!(at.node, Node::List(_)) {
            let message = format!("found {} entries", items.len());
            findings.add(Code::WrongType, at.place(), message, expected, None);
        }
        return None;
    };
    let (least, largest) = (findings.duration(least)?, findings.duration(largest)?);
    if largest < least {
        findings.add(
            Code::TimeOrder,
            at.place(),
            format!("the minimum {} is longer than the maximum {}", written(least), written(largest)),
            expected,
            None,
        );
    }
    Some((least, largest.max(least)))
}
