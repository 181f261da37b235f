//! `downbeat drivers`: lists the drivers, and the packages that they need.

use std::process::Command;

use serde::Serialize;

use super::{Exit, Format, console};

/// List the drivers for hardware, with the address to write into the fleet file, and their requirements.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  downbeat drivers
  downbeat drivers --interpreter venv/bin/python --format json")]
pub(super) struct DriversArgs {
    /// The Python in which to look for the packages that drivers need.
    #[arg(long, default_value = "python3", value_name = "PROGRAM")]
    interpreter: String,
}

/// A driver in the list.
#[derive(Debug)]
struct Listed {
    name: &'static str,
    hardware: &'static str,
    /// An example of the robot's `address` in the fleet file.
    address: &'static str,
    /// The requirement of a driver in Python; `None` for a driver in this program.
    python: Option<Requirement>,
}

/// The package that a driver in Python needs.
#[derive(Clone, Copy, Debug, Serialize)]
struct Requirement {
    /// Name of the optional dependency of `downbeat-driver`.
    extra: &'static str,
    /// A module of the package.
    #[serde(skip)]
    module: &'static str,
}

const fn built_in(name: &'static str, hardware: &'static str, address: &'static str) -> Listed {
    Listed { name, hardware, address, python: None }
}

const fn in_python(
    name: &'static str,
    hardware: &'static str,
    address: &'static str,
    python: Requirement,
) -> Listed {
    Listed { name, hardware, address, python: Some(python) }
}

const fn needs(extra: &'static str, module: &'static str) -> Requirement {
    Requirement { extra, module }
}

static LIST: [Listed; 15] = [
    built_in("sim", "no hardware: a simulation", "sim"),
    built_in("program", "a program of yours, in any language", "program:python3 drive.py"),
    built_in("thrift", "a robot that speaks the early form of URRCP", "thrift://tank.local:9090"),
    built_in("sacn", "DMX fixtures behind a node for sACN", "sacn:1/13"),
    built_in("artnet", "DMX fixtures behind a node for Art-Net", "artnet:0/5@10.0.0.5"),
    built_in("osc", "receivers of Open Sound Control", "osc:10.0.0.7:53000/cue"),
    in_python(
        "crazyflie",
        "a Crazyflie drone",
        "program:python3 -m downbeat_driver.crazyflie radio://0/80/2M/E7E7E7E7E7 height=z",
        needs("crazyflie", "cflib"),
    ),
    in_python(
        "dynamixel",
        "Dynamixel servos with protocol 2.0",
        "program:python3 -m downbeat_driver.dynamixel /dev/ttyUSB0 shoulder=1 elbow=2",
        needs("dynamixel", "dynamixel_sdk"),
    ),
    in_python(
        "maestro",
        "hobby servos on a Pololu Maestro",
        "program:python3 -m downbeat_driver.maestro /dev/ttyACM0 pan=0 tilt=1:600-2400",
        needs("serial", "serial"),
    ),
    in_python(
        "modbus",
        "registers and coils, over TCP or a serial line",
        "program:python3 -m downbeat_driver.modbus plc.local gate=h40:int16*10 lamp=c3",
        needs("modbus", "pymodbus"),
    ),
    in_python(
        "mqtt",
        "topics of an MQTT broker",
        "program:python3 -m downbeat_driver.mqtt broker.local lamp=zigbee2mqtt/lamp/set:brightness",
        needs("mqtt", "paho"),
    ),
    in_python(
        "opcua",
        "variables of an OPC UA server",
        "program:python3 -m downbeat_driver.opcua opc.tcp://plc.local:4840 'arm=ns=2;s=Arm.Target'",
        needs("opcua", "asyncua"),
    ),
    in_python(
        "pca9685",
        "hobby servos on a PCA9685",
        "program:python3 -m downbeat_driver.pca9685 /dev/i2c-1 pan=0 tilt=1:600-2400",
        needs("pca9685", "smbus2"),
    ),
    in_python(
        "serial_line",
        "a microcontroller that answers lines of text",
        "program:python3 -m downbeat_driver.serial_line /dev/ttyACM0",
        needs("serial", "serial"),
    ),
    in_python(
        "ur_rtde",
        "an arm of Universal Robots",
        "program:python3 -m downbeat_driver.ur_rtde 192.168.0.10",
        needs("ur_rtde", "rtde_control"),
    ),
];

/// The module of the package with the drivers.
const PACKAGE: &str = "downbeat_driver";

/// The modules that a Python can import.
enum Modules {
    Found(Vec<String>),
    /// The Python cannot be run, for this reason.
    Unknown(String),
}

impl Modules {
    /// Asks a Python which of the modules it can find, without importing them.
    fn of(interpreter: &str) -> Self {
        let script = "import importlib.util, sys\nfor name in sys.argv[1:]:\n    if importlib.util.find_spec(name): print(name)";
        let wanted = LIST.iter().filter_map(|driver| driver.python).map(|needed| needed.module);
        match Command::new(interpreter).args(["-c", script, PACKAGE]).args(wanted).output() {
            Ok(ran) if ran.status.success() => {
                Self::Found(String::from_utf8_lossy(&ran.stdout).lines().map(str::to_owned).collect())
            }
            Ok(ran) => Self::Unknown(format!("`{interpreter}` ended with {}", ran.status)),
            Err(error) => Self::Unknown(format!("`{interpreter}` cannot be started: {error}")),
        }
    }

    /// Returns the reason why a driver is not ready, with its remedy, or `None` if it is.
    fn missing(&self, driver: &Listed) -> Option<String> {
        let needed = driver.python?;
        let has = |found: &[String], name: &str| found.iter().any(|module| module == name);
        match self {
            Self::Unknown(reason) => Some(reason.clone()),
            Self::Found(found) if has(found, PACKAGE) && has(found, needed.module) => None,
            Self::Found(_) => {
                Some(format!("not installed: pip install './robot/drivers/python[{}]'", needed.extra))
            }
        }
    }
}

pub(super) fn drivers(args: &DriversArgs, format: Format) -> Exit {
    let modules = Modules::of(&args.interpreter);
    match format {
        Format::Json => {
            let described = |driver: &Listed| {
                serde_json::json!({
                    "name": driver.name,
                    "hardware": driver.hardware,
                    "address": driver.address,
                    "python": driver.python,
                    "missing": modules.missing(driver),
                })
            };
            let listed: Vec<_> = LIST.iter().map(described).collect();
            console::print_json(&serde_json::json!({ "drivers": listed }));
        }
        Format::Text => {
            console::print(&LIST.iter().map(|driver| lines(driver, &modules)).collect::<String>())
        }
    }
    Exit::Done
}

/// Returns the driver's name and hardware, its address, and its missing requirement.
fn lines(driver: &Listed, modules: &Modules) -> String {
    let missing = modules.missing(driver).map(|reason| format!("    {reason}\n")).unwrap_or_default();
    format!("{:<12} {}\n    address: \"{}\"\n{missing}", driver.name, driver.hardware, driver.address)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use downbeat_scripts::Address;

    use super::*;

    fn file(name: &str) -> String {
        let path = format!("{}/../{name}", env!("CARGO_MANIFEST_DIR"));
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"))
    }

    #[test]
    fn each_driver_of_the_python_package_is_listed_with_its_requirement() {
        let folder = format!("{}/../robot/drivers/python/downbeat_driver", env!("CARGO_MANIFEST_DIR"));
        let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let modules = names.filter_map(|name| Some(name.to_str()?.strip_suffix(".py")?.to_owned()));
        let with_extra = |module: &String| {
            let text = file(&format!("robot/drivers/python/downbeat_driver/{module}.py"));
            text.lines()
                .find_map(|line| line.strip_prefix("    extra = \"")?.strip_suffix('"').map(str::to_owned))
        };
        let found: BTreeSet<_> =
            modules.filter_map(|module| Some((module.clone(), with_extra(&module)?))).collect();
        let listed =
            LIST.iter().filter_map(|driver| Some((driver.name.to_owned(), driver.python?.extra.to_owned())));
        assert_eq!(found, listed.collect());
        let project = file("robot/drivers/python/pyproject.toml");
        for (_, extra) in found {
            assert!(project.contains(&format!("\n{extra} = [")), "{extra}");
        }
    }

    #[test]
    fn each_driver_has_a_section_in_its_document() {
        let (drivers, lights, edge) = (file("docs/drivers.md"), file("docs/lights.md"), file("docs/edge.md"));
        for driver in &LIST {
            let is_described = match driver.python {
                Some(_) => {
                    drivers.contains(&format!("\n## `{}`", driver.name)) && drivers.contains(driver.address)
                }
                None => lights.contains(driver.address) || edge.contains(driver.name),
            };
            assert!(is_described, "{}", driver.name);
        }
    }

    #[test]
    fn a_missing_package_is_named_with_its_installation() {
        let dynamixel = LIST.iter().find(|driver| driver.name == "dynamixel").unwrap();
        let found = |names: &[&str]| Modules::Found(names.iter().map(|name| (*name).to_owned()).collect());
        let missing = Some("not installed: pip install './robot/drivers/python[dynamixel]'".to_owned());
        assert_eq!(found(&[PACKAGE]).missing(dynamixel), missing);
        assert_eq!(found(&["dynamixel_sdk"]).missing(dynamixel), missing);
        assert_eq!(found(&[PACKAGE, "dynamixel_sdk"]).missing(dynamixel), None);
        let unknown = Modules::of("/nonexistent/python");
        assert!(unknown.missing(dynamixel).unwrap().starts_with("`/nonexistent/python` cannot be started"));
    }

    #[test]
    fn each_address_is_one_that_a_fleet_file_accepts() {
        for driver in &LIST {
            assert!(driver.address.parse::<Address>().is_ok(), "{}", driver.address);
        }
    }
}
