//! What a host runs: a robot alone, or one with hardware behind a driver on a thread of its own.

use std::io;
use std::sync::{Arc, mpsc as std_mpsc};
use std::thread::JoinHandle;

use urrcp::InitializationBlock;

use super::Order;
use crate::driver::{AtStart, Driver, DriverOptions, Mailbox, News, Wanted, Worker};
use crate::simulated::SimulatedRobot;

/// A driver's thread; its error is why devices that were moved may not be in their default state.
pub(super) type DriverThread = JoinHandle<Result<(), String>>;

/// A robot for a host.
pub struct Hosted {
    pub(super) robot: SimulatedRobot,
    driver: Option<(Box<dyn Driver>, DriverOptions)>,
}

impl From<SimulatedRobot> for Hosted {
    fn from(robot: SimulatedRobot) -> Self {
        Self { robot, driver: None }
    }
}

impl Hosted {
    /// A robot that drives hardware. Its clock is the host's.
    #[must_use]
    pub fn driven(mut block: InitializationBlock, driver: Box<dyn Driver>, options: DriverOptions) -> Self {
        // The machine reports, whatever the hardware can.
        block.reports = true;
        Self { robot: SimulatedRobot::driven(block), driver: Some((driver, options)) }
    }

    /// Starts the driver's thread, if there is one. It ends once its mailbox is closed.
    pub(super) fn attach(
        self,
        index: usize,
        orders: &std_mpsc::Sender<Order>,
    ) -> io::Result<(SimulatedRobot, Option<Attached>, Option<DriverThread>)> {
        let Some((driver, options)) = self.driver else { return Ok((self.robot, None, None)) };
        let mailbox = Arc::new(Mailbox::default());
        let orders = orders.clone();
        // At most the open readings and a word a connection are on the way; a host that has stopped hears nothing.
        let tell = move |news| drop(orders.send(Order::Hardware { robot: index, news }));
        let block = self.robot.robot().block().clone();
        let worker =
            Worker::new(driver, block, Arc::clone(&mailbox), options.samples_per_second, Box::new(tell));
        let thread = std::thread::Builder::new().name("driver".into()).spawn(move || worker.run())?;
        let attached = Attached { mailbox, connection: 0, at_start: options.at_start };
        Ok((self.robot, Some(attached), Some(thread)))
    }
}

/// The host's end of a driver.
pub(super) struct Attached {
    pub(super) mailbox: Arc<Mailbox>,
    /// Which connection the robot's machine knows of.
    connection: u64,
    at_start: AtStart,
}

impl Drop for Attached {
    fn drop(&mut self) {
        self.mailbox.close();
    }
}

impl Attached {
    /// Passes on what is wanted of the hardware.
    pub(super) fn post(&self, robot: &mut SimulatedRobot, clock: &crate::clock::HostClock) {
        let now = clock.now();
        let ahead = robot.robot_from_true(now) - now.assume_clock();
        let next_due = robot.next_wakeup().map(|at| clock.instant_of(at));
        let orders = robot.take_wanted().into_iter().map(|wanted: Wanted| wanted.on_clock(*clock, ahead));
        self.mailbox.post(self.connection, orders, next_due);
    }

    /// Tells the robot what its driver's thread says.
    pub(super) fn hear(&mut self, robot: &mut SimulatedRobot, clock: &crate::clock::HostClock, news: News) {
        let now = clock.now();
        match news {
            News::There { connection } => {
                self.connection = connection;
                robot.drive(now, |machine, now, out| machine.hardware_found(now, out));
                if connection == 1 && self.at_start == AtStart::Default {
                    robot.drive(now, |machine, now, out| machine.restore(now, out));
                }
            }
            News::Away { reason } => {
                robot.drive(now, |machine, now, out| machine.hardware_lost(now, &reason, out));
            }
            News::Reading { id, reading } => {
                robot.drive(now, |machine, now, out| machine.reading_came(now, id, reading, out));
            }
        }
    }
}
