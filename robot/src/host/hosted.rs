//! A robot that a host can run: either with hardware behind a driver, or in a simulated world.

use std::io;
use std::sync::Arc;
use std::thread::JoinHandle;

use urrcp::{InitializationBlock, RobotId};

use super::Order;
use super::body::Body;
use crate::driver::{Driver, DriverOptions, HardwareEvent, Mailbox, Worker};
use crate::edge::Edge;
use crate::robot::Robot;
use crate::simulated::SimulatedRobot;
use crate::tolerance::Tolerance;

/// A driver's thread. If devices were moved and may not be at rest, it returns an error with the reason.
pub(super) type DriverThread = JoinHandle<Result<(), String>>;

/// A robot that a host can run. [`Hosted::driven`] creates one with hardware behind a driver; `into` converts a simulated robot.
pub struct Hosted(Surroundings);

type Watch = Box<dyn Fn(&HardwareEvent) + Send>;

#[expect(clippy::large_enum_variant, reason = "there are a few hundred at most, and none is moved often")]
enum Surroundings {
    Hardware {
        block: InitializationBlock,
        driver: Box<dyn Driver>,
        options: DriverOptions,
        watch: Watch,
        tolerance: Tolerance,
    },
    World(SimulatedRobot),
}

impl From<SimulatedRobot> for Hosted {
    fn from(robot: SimulatedRobot) -> Self {
        Self(Surroundings::World(robot))
    }
}

impl Hosted {
    /// Creates a robot that drives hardware. Its clock is the host's clock, which should follow NTP. The robot reports its actions and
    /// answers inquiries, even if `block` states otherwise.
    #[must_use]
    pub fn driven(mut block: InitializationBlock, driver: Box<dyn Driver>, options: DriverOptions) -> Self {
        // The robot's machine makes the reports, whatever the hardware can do.
        block.reports = true;
        let (watch, tolerance) = (Box::new(|_: &_| {}), Tolerance::default());
        Self(Surroundings::Hardware { block, driver, options, watch, tolerance })
    }

    /// Sets a function that the driver's thread calls with each event of the hardware. It is never called for a robot in a simulated
    /// world.
    #[must_use]
    pub fn watched(mut self, watch: impl Fn(&HardwareEvent) + Send + 'static) -> Self {
        if let Surroundings::Hardware { watch: watched, .. } = &mut self.0 {
            *watched = Box::new(watch);
        }
        self
    }

    /// Sets the maximum delays that the robot tolerates, instead of the defaults.
    #[cfg(test)]
    pub(crate) fn tolerating(mut self, limits: Tolerance) -> Self {
        match &mut self.0 {
            Surroundings::Hardware { tolerance, .. } => *tolerance = limits,
            Surroundings::World(robot) => *robot = robot.clone().tolerating(limits),
        }
        self
    }

    pub(super) fn id(&self) -> &RobotId {
        &self.block().id
    }

    pub(super) fn block(&self) -> &InitializationBlock {
        match &self.0 {
            Surroundings::Hardware { block, .. } => block,
            Surroundings::World(robot) => robot.robot().block(),
        }
    }

    /// Starts the driver's thread, if there is a driver. The thread ends once the mailbox that contains its requests is closed.
    pub(super) fn attach(
        self,
        index: usize,
        orders: &flume::Sender<Order>,
    ) -> io::Result<(Body, Option<DriverThread>)> {
        let (block, driver, options, watch, tolerance) = match self.0 {
            Surroundings::World(robot) => return Ok((Body::Simulated(Box::new(robot)), None)),
            Surroundings::Hardware { block, driver, options, watch, tolerance } => {
                (block, driver, options, watch, tolerance)
            }
        };
        let limits = options.limits.clone();
        let mailbox = Arc::new(Mailbox::tolerating(tolerance));
        let orders = orders.clone();
        // At most the pending readings and one report per connection wait; a host that has stopped receives none.
        let tell = move |news| {
            HardwareEvent::of(&news).iter().for_each(&watch);
            drop(orders.send(Order::Hardware { robot: index, news }));
        };
        let worker =
            Worker::new(driver, block.clone(), Arc::clone(&mailbox), options.clone(), Box::new(tell));
        let thread = std::thread::Builder::new().name("driver".into()).spawn(move || worker.run())?;
        let robot = Robot::driven(block).with_limits(&limits).tolerating(tolerance);
        let edge = Edge::new(robot, mailbox);
        Ok((Body::Edge(Box::new(edge)), Some(thread)))
    }
}
