//! Turns the fleet file into robots that can be reached.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use downbeat_robot::driver::{self, AtEnd, Driver, DriverError, DriverOptions, DriverSpec, Timeouts};
use downbeat_robot::simulated::{Fault, Moves, Settings, SimulatedRobot};
use downbeat_robot::{Host, HostError, HostOptions, Hosted, MotionLimits};
use downbeat_scripts::{
    Act, Address, Choreography, DmxAddress, DmxProtocol, Fleet, FleetRobot, Handshake, MavlinkAddress,
    MissionSettings, OscAddress, Plan, Positions, RateLimits, SimulatedMoves, VehicleEnd, Wait, counted,
    plan_approach, plan_home,
};
use urrcp::{DeviceId, Encoding, RobotId, Setpoint, Span};

use crate::link::{Endpoint, LinkEncoding, Site};
use downbeat_mission::{ActIndex, Destination, Greeting, Participant, PlanTransfer};

/// The error for a robot that cannot be simulated, because the fleet file does not describe it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "robot `{robot}` has no `init:` file in the fleet file; add one, because simulated robots require it"
)]
pub struct NoInit {
    /// The robot's id.
    pub robot: RobotId,
}

/// Why robots that run in this process cannot be started, or robots elsewhere cannot be connected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EndpointError {
    /// The fleet file has no `init:` file for a robot.
    #[error(transparent)]
    NoInit(#[from] NoInit),
    /// A robot's driver cannot be used.
    #[error("robot `{robot}`: {error}")]
    Driver {
        /// The robot's id.
        robot: RobotId,
        /// Why the driver cannot be used.
        error: DriverError,
    },
    /// The operator's identity (certificate and key) cannot be used.
    #[error("{0}")]
    Identity(String),
    /// The Zenoh network cannot be joined.
    #[error("{0}")]
    Network(String),
    /// The host, which runs the robots of this process, cannot start.
    #[error(transparent)]
    Host(#[from] HostError),
}

/// Returns the fleet's robots that the plan moves, in the plan's order.
#[must_use]
pub fn robots_of<'a>(fleet: &'a Fleet, plan: &Plan) -> Vec<&'a FleetRobot> {
    let by_id: std::collections::HashMap<_, _> =
        fleet.robots.iter().map(|robot| (&robot.id, robot)).collect();
    plan.robots.iter().filter_map(|planned| by_id.get(&planned.robot).copied()).collect()
}

/// Returns the fleet's robots that a choreography moves or reads, in the fleet's order.
#[must_use]
pub fn robots_in<'a>(fleet: &'a Fleet, choreography: &Choreography) -> Vec<&'a FleetRobot> {
    let moved = choreography.acts.iter().flat_map(|act| &act.plan.robots).map(|robot| robot.robot.as_str());
    let read = choreography.acts.iter().flat_map(|act| &act.readings).map(|reading| reading.robot.as_str());
    let awaited = choreography.acts.iter().filter_map(|act| match &act.wait {
        Wait::Sensor { robot, .. } => Some(robot.as_str()),
        _ => None,
    });
    let all: std::collections::HashSet<&str> = moved.chain(read).chain(awaited).collect();
    fleet.robots.iter().filter(|robot| all.contains(robot.id.as_str())).collect()
}

/// Plans the acts that move robots to their destinations after a stop, with the settings of a fleet file.
#[derive(Debug)]
struct Planner(Fleet);

impl PlanTransfer for Planner {
    fn plan(
        &self,
        choreography: &Choreography,
        to: Destination,
        like: ActIndex,
        from: &Positions,
    ) -> Result<Option<Act>, String> {
        let planned = match to {
            Destination::Home => plan_home(choreography, like.get(), &self.0, from),
            Destination::Act(act) => plan_approach(choreography, act.get(), &self.0, from),
        };
        planned.map_err(|errors| {
            let first = errors.first().map(|error| error.message.clone()).unwrap_or_default();
            match errors.len() {
                0 | 1 => first,
                more => format!("{first}; {} more", counted(more - 1, "error")),
            }
        })
    }
}

/// Returns the planner of the acts that move robots to their destinations after a stop, for
/// [`downbeat_mission::MissionOptions::transfer`].
#[must_use]
pub fn transfer(fleet: &Fleet) -> Arc<dyn PlanTransfer> {
    Arc::new(Planner(fleet.clone()))
}

/// Converts robots of the fleet file to the mission's participants, in the same order.
#[must_use]
pub fn participants(robots: &[&FleetRobot]) -> Vec<Participant> {
    let participant = |robot: &&FleetRobot| Participant {
        id: robot.id.clone(),
        block: robot.init.clone(),
        settings: settings_of(robot),
        in_process: !robot.address.is_served(),
    };
    robots.iter().map(participant).collect()
}

fn settings_of(robot: &FleetRobot) -> MissionSettings {
    let encoding = match &robot.address {
        Address::Tcp { .. } | Address::Zenoh { .. } => robot.mission.encoding,
        // Messages within this process are not encoded.
        _ => Encoding::Json,
    };
    MissionSettings { encoding, ..robot.mission.clone() }
}

/// Returns whether the mission performs handshake steps 1 to 4 (availability and description) with its robots, as the fleet file's
/// `handshake:` states.
#[must_use]
pub fn greeting(fleet: &Fleet) -> Greeting {
    match fleet.handshake {
        Handshake::Full => Greeting::Full,
        Handshake::Skip => Greeting::Skip,
    }
}

/// Creates a simulated robot. Each robot of a fleet uses a different random seed.
///
/// # Errors
/// Returns [`NoInit`] if the fleet file does not describe the robot.
pub fn simulated(robot: &FleetRobot, seed: u64) -> Result<SimulatedRobot, NoInit> {
    simulated_with(robot, settings(robot, seed))
}

fn simulated_with(robot: &FleetRobot, settings: Settings) -> Result<SimulatedRobot, NoInit> {
    let block = robot.init.clone().ok_or_else(|| NoInit { robot: robot.id.clone() })?;
    let mut simulated = SimulatedRobot::new(block, settings);
    for (sensor, reading) in &robot.simulation.readings {
        simulated.set_reading(sensor.clone(), *reading);
    }
    Ok(simulated)
}

/// Creates the robot for a dry run. If the fleet file sets no message delay, the delay of a wired network is used: if messages were
/// delivered instantly, a dry run would not show messages that are late in reality.
///
/// # Errors
/// Returns [`NoInit`] if the fleet file does not describe the robot.
pub fn rehearsed(robot: &FleetRobot, seed: u64) -> Result<SimulatedRobot, NoInit> {
    let settings = settings(robot, seed);
    let delay = settings.delay.or(Some(WIRED));
    simulated_with(robot, Settings { delay, ..settings })
}

/// Like [`rehearsed`], but applies `change` to the simulation's settings first.
///
/// # Errors
/// Returns [`NoInit`] if the fleet file does not describe the robot.
pub fn rehearsed_with(
    robot: &FleetRobot,
    change: impl FnOnce(&mut Settings),
) -> Result<SimulatedRobot, NoInit> {
    let mut settings = settings(robot, 0);
    settings.delay = settings.delay.or(Some(WIRED));
    change(&mut settings);
    simulated_with(robot, settings)
}

/// Minimum and maximum one-way delay in a wired network.
pub const WIRED: (Span, Span) = (Span::from_micros(100), Span::from_micros(500));

fn settings(robot: &FleetRobot, seed: u64) -> Settings {
    let from = &robot.simulation;
    Settings {
        clock_offset: from.clock_offset,
        drift_ppm: from.drift_ppm,
        jitter: from.jitter,
        ntp_error: from.ntp_error,
        delay: from.delay,
        fault: from.fault.map(|fault| match fault {
            downbeat_scripts::Fault::Refuse => Fault::Refuse,
            downbeat_scripts::Fault::Silent => Fault::Silent,
            downbeat_scripts::Fault::Disconnect => Fault::Disconnect,
        }),
        moves: from.moves.iter().map(moves).collect(),
        limits: limits(robot),
        seed,
    }
}

/// Returns the limits of speed and acceleration, from the fleet file, for motions of the robot's devices to rest or home.
fn limits(robot: &FleetRobot) -> BTreeMap<DeviceId, MotionLimits> {
    let limit = |(device, limits): (&String, &RateLimits)| {
        let RateLimits { speed, acceleration } = *limits;
        Some((DeviceId::new(device).ok()?, MotionLimits { speed, acceleration }))
    };
    robot.limits.iter().filter_map(limit).collect()
}

fn moves(of: &SimulatedMoves) -> Moves {
    let SimulatedMoves { device, latency, spread, time_constant, sensor, noise, delay } = of.clone();
    Moves { device, latency, spread, time_constant, sensor, noise, delay }
}

/// Minimum time for which the mission waits for the hardware of robots in this process. The mission then begins without missing hardware.
const HARDWARE_WAIT: Duration = Duration::from_secs(10);
/// Interval between checks of the hardware in [`await_hardware`].
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// Whether the programs that the fleet file names as drivers are started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartPrograms {
    /// Driver programs are started, because the operator requested it or plays a mission.
    Yes,
    /// Driver programs are not started, and their robots are unavailable. A read-only command executes no program that a file names.
    No,
}

/// Settings for the drivers of robots in this process.
#[derive(Clone, Copy, Debug)]
pub struct Drivers {
    /// Whether programs that the fleet file names as drivers are started.
    pub programs: StartPrograms,
    /// Maximum times that a driver program may take to answer.
    pub timeouts: Timeouts,
}

impl From<StartPrograms> for Drivers {
    fn from(programs: StartPrograms) -> Self {
        Self { programs, timeouts: Timeouts::default() }
    }
}

impl Drivers {
    /// Returns how long to wait for the hardware. A driver program has the start timeout for each of its first two lines. One additional
    /// second allows the driver to report why the program missed the timeout.
    fn wait(self) -> Duration {
        (self.timeouts.start * 2 + Duration::from_secs(1)).max(HARDWARE_WAIT)
    }
}

/// The driver that replaces a program that is not started. It refuses every call.
struct NotStarted;

impl NotStarted {
    fn refused<T>() -> Result<T, DriverError> {
        let reason = "its program is not started without --start-programs";
        Err(DriverError::Away(reason.to_owned()))
    }
}

impl Driver for NotStarted {
    fn connect(&mut self) -> Result<(), DriverError> {
        Self::refused()
    }

    fn set(&mut self, _device: &DeviceId, _setpoint: &Setpoint) -> Result<(), DriverError> {
        Self::refused()
    }

    fn read(&mut self, _sensor: &DeviceId) -> Result<f64, DriverError> {
        Self::refused()
    }

    fn ping(&mut self) -> Result<(), DriverError> {
        Self::refused()
    }
}

/// Returns the driver for the hardware at an address. `None` if the robot itself listens at the address.
#[must_use]
pub fn driver_of(address: &Address) -> Option<DriverSpec> {
    match address {
        Address::Tcp { .. } | Address::Zenoh { .. } => None,
        Address::Simulated => Some(DriverSpec::Simulated),
        Address::Thrift { host, port, id } => {
            Some(DriverSpec::Thrift { host: host.clone(), port: *port, id: id.clone() })
        }
        Address::Dmx(address) => Some(DriverSpec::Dmx(fixture(address))),
        Address::Osc(OscAddress { host, port, path }) => {
            Some(DriverSpec::Osc(driver::OscAddress::new(host.clone(), *port, path.clone())))
        }
        Address::Mavlink(address) => Some(DriverSpec::Mavlink(vehicle(address))),
        Address::Program { command } => Some(DriverSpec::Program { command: command.clone() }),
    }
}

fn fixture(address: &DmxAddress) -> driver::DmxAddress {
    let protocol = match address.protocol {
        DmxProtocol::Sacn => driver::DmxProtocol::Sacn,
        DmxProtocol::ArtNet => driver::DmxProtocol::ArtNet,
    };
    let at_end = if address.blackout { AtEnd::Blackout } else { AtEnd::Hold };
    driver::DmxAddress::new(protocol, address.universe, address.channel, address.host.clone())
        .with_priority(address.priority.unwrap_or(driver::PRIORITY))
        .with_at_end(at_end)
}

fn vehicle(address: &MavlinkAddress) -> driver::MavlinkAddress {
    let at_end = match address.at_end {
        VehicleEnd::Hold => driver::VehicleEnd::Hold,
        VehicleEnd::Land => driver::VehicleEnd::Land,
        VehicleEnd::ReturnToLaunch => driver::VehicleEnd::ReturnToLaunch,
    };
    driver::MavlinkAddress::new(address.host.clone(), address.port)
        .with_system(address.system)
        .with_takeoff(address.takeoff_mm.unwrap_or(driver::TAKEOFF_MM))
        .with_at_end(at_end)
}

/// Creates the robot if it runs in this process: a simulated one, or one with a driver for its hardware. Returns `None` if the robot
/// listens at a network address itself.
fn hosted(robot: &FleetRobot, seed: u64, drivers: Drivers) -> Result<Option<Hosted>, EndpointError> {
    let Some(spec) = driver_of(&robot.address) else { return Ok(None) };
    if spec == DriverSpec::Simulated {
        return Ok(Some(simulated(robot, seed)?.into()));
    }
    let block = robot.init.clone().ok_or_else(|| NoInit { robot: robot.id.clone() })?;
    let refused = |error| EndpointError::Driver { robot: robot.id.clone(), error };
    let driver = match (&spec, drivers.programs) {
        (DriverSpec::Program { .. }, StartPrograms::No) => Box::new(NotStarted),
        _ => spec.driver_within(&block, drivers.timeouts).map_err(refused)?,
    };
    Ok(Some(Hosted::driven(block, driver, DriverOptions::default().with_limits(limits(robot)))))
}

/// Returns the endpoint of each robot. Robots without `address: tcp://`, `tls://`, `hmac://` or `zenoh:` are started in this process.
///
/// # Errors
/// Returns [`EndpointError`] if a robot cannot be simulated or driven, or if the host cannot start.
pub fn endpoints(
    robots: &[&FleetRobot],
    handshake: Handshake,
    site: &Site,
    options: HostOptions,
    drivers: Drivers,
) -> Result<(Option<Host>, Vec<Endpoint>), EndpointError> {
    let (host, endpoints) = endpoints_at_once(robots, handshake, site, options, drivers)?;
    if let Some(host) = &host {
        host.await_hardware(drivers.wait());
    }
    Ok((host, endpoints))
}

/// Waits for the hardware of the host's robots as [`endpoints`] does, but without blocking the thread.
#[expect(clippy::disallowed_methods, reason = "drivers connect in real time")]
pub async fn await_hardware(host: &Host, drivers: Drivers) {
    let until = Instant::now() + drivers.wait();
    while !host.await_hardware(Duration::ZERO) && Instant::now() < until {
        tokio::time::sleep(LOOK_EVERY).await;
    }
}

/// Like [`endpoints`], but does not wait until drivers have connected to their hardware.
///
/// # Errors
/// Returns [`EndpointError`] if a robot cannot be simulated or driven, or if the host cannot start.
pub fn endpoints_at_once(
    robots: &[&FleetRobot],
    handshake: Handshake,
    site: &Site,
    options: HostOptions,
    drivers: Drivers,
) -> Result<(Option<Host>, Vec<Endpoint>), EndpointError> {
    let network = robots.iter().any(|robot| matches!(robot.address, Address::Zenoh { .. }));
    let network = network.then(|| site.network()).transpose().map_err(EndpointError::Network)?;
    let mut machines: Vec<Hosted> = Vec::new();
    // The index of each robot in the host, if it runs there.
    let mut places = Vec::new();
    for robot in robots {
        let hosted = hosted(robot, machines.len() as u64, drivers)?;
        places.push(hosted.is_some().then_some(machines.len()));
        machines.extend(hosted);
    }
    let host = if machines.is_empty() { None } else { Some(Host::start(machines, options)?) };
    let endpoint = |(robot, place): (&&FleetRobot, Option<usize>)| match (&robot.address, place, &host) {
        (Address::Tcp { host, port, protection }, ..) => {
            let encoding = encoding(robot, handshake);
            let own_id = robot.init.as_ref().map_or(&robot.id, |init| &init.id);
            let security = site.with(*protection, Some(own_id));
            Some(Endpoint::Tcp { host: host.clone(), port: *port, encoding, security })
        }
        (Address::Zenoh { key }, ..) => {
            network.as_ref().and_then(|network| network.endpoint(key, encoding(robot, handshake)))
        }
        (_, Some(index), Some(host)) => Some(Endpoint::InProcess { host: host.handle(), index }),
        _ => None,
    };
    let endpoints = robots.iter().zip(places).filter_map(endpoint).collect();
    Ok((host, endpoints))
}

/// Returns the encoding for messages to a robot. Without a handshake, the robot's init file determines whether that encoding is used at
/// once.
fn encoding(robot: &FleetRobot, handshake: Handshake) -> LinkEncoding {
    let encoding = robot.mission.encoding;
    let listed = robot.init.as_ref().is_some_and(|block| block.understands(encoding));
    match handshake {
        Handshake::Skip if listed => LinkEncoding::at_once(encoding),
        Handshake::Skip | Handshake::Full => LinkEncoding::once_listed(encoding),
    }
}
