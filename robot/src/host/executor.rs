//! The precise thread, which runs the robots of a host: it wakes for due events and for orders, advances the robots, and sends their
//! messages.

use std::collections::{BTreeSet, HashMap};
use std::io;
use std::sync::{Arc, mpsc as std_mpsc};
use std::thread::JoinHandle;

use tokio::sync::{OwnedSemaphorePermit, oneshot, watch};
#[cfg(any(feature = "sealed", feature = "tls"))]
use urrcp::Label;
use urrcp::{ErrorCode, Message, Span, Timestamp};

use super::HostError;
use super::audit::Audit;
use super::body::Body;
use super::log::Log;
use super::outbox::Outbox;
use crate::clock::{HostClock, HostTime};
use crate::driver::News;
use crate::figures::Figures;
use crate::ids::LinkId;
use crate::outgoing::Outgoing;
use crate::parties::Claimant;
#[cfg(any(feature = "sealed", feature = "tls"))]
use crate::peer::Peer;
use crate::refusals::{Reason, Refusals};
use crate::robot::Input;
use downbeat_realtime::{PreciseWait, Woken};
use downbeat_realtime::{Realtime, Scheduling};

/// Maximum delay with which an imprecise sleep of the precise thread may end. If a robot moves within this time after the next due event,
/// the thread waits precisely instead.
const MOVES_SOON: Span = Span::from_millis(3);

/// An order for the precise thread, which runs the robots.
pub(super) enum Order {
    Open {
        robot: usize,
        link: LinkId,
        outbox: Outbox,
    },
    /// An input for a robot. The permit, if any, is released once the robot has taken the input.
    Input {
        robot: usize,
        link: LinkId,
        input: Input,
        permit: Option<OwnedSemaphorePermit>,
    },
    /// A key is no longer valid: the commands of the peers that used it end, and their links are closed.
    #[cfg(any(feature = "sealed", feature = "tls"))]
    Bar {
        robot: usize,
        serial: Label,
        why: String,
    },
    /// Makes a robot check whether its session is over. Once the permit is released, [`HostHandle::owner`] shows the result.
    Look {
        robot: usize,
        permit: oneshot::Sender<()>,
    },
    /// A report from the thread of a robot's driver.
    Hardware {
        robot: usize,
        news: News,
    },
    /// Asks the precise thread to answer, which shows that it is running.
    Beat {
        answer: oneshot::Sender<()>,
    },
    /// Ends the precise thread, because the host is shutting down.
    Stop,
}

/// The precise thread, the channel on which it receives its robots, and the scheduling that it was granted.
pub(super) type Prepared = (JoinHandle<()>, std_mpsc::Sender<Vec<Body>>, Scheduling);

/// Starts the precise thread (which will run the robots) before it has robots, so that nothing moves if the required scheduling is not
/// granted. The thread ends with [`Order::Stop`], when every handle is dropped, or when it receives no robots.
pub(super) fn prepared_thread(
    realtime: Realtime,
    told: Destinations,
    inbox: flume::Receiver<Order>,
) -> Result<Prepared, HostError> {
    let (ready, robots) = std_mpsc::channel();
    let (tell, granted) = std_mpsc::channel();
    let run = move || {
        let scheduling = Scheduling::of_this_thread(realtime);
        let waits = PreciseWait::new(&scheduling);
        let _given_up = tell.send(scheduling);
        if let Ok(robots) = robots.recv() {
            Executor::new(robots, told, waits).run(&inbox);
        }
    };
    let thread = std::thread::Builder::new().name("robots".into()).spawn(run).map_err(HostError::Thread)?;
    let scheduling = granted.recv().map_err(|error| HostError::Thread(io::Error::other(error)))?;
    if realtime == Realtime::Required && scheduling.lacks_something() {
        return Err(HostError::Realtime(scheduling));
    }
    Ok((thread, ready, scheduling))
}

/// The destinations to which the precise thread reports: log, owners, refusals and metrics.
pub(super) struct Destinations {
    pub(super) log: Option<Log>,
    /// Channels that publish the current owner of each robot, one per robot.
    pub(super) owners: Vec<watch::Sender<Option<Claimant>>>,
    pub(super) refusals: Arc<Refusals>,
    pub(super) figures: Arc<Figures>,
    pub(super) audit: Option<Audit>,
}

/// A change in the number of a robot's connections.
#[derive(Clone, Copy, Debug)]
enum Change {
    Opened,
    Closed,
}

/// State of the precise thread, which runs the robots.
struct Executor {
    robots: Vec<Body>,
    wakeups: BTreeSet<(Timestamp<HostTime>, usize)>,
    wakeup_of: Vec<Option<Timestamp<HostTime>>>,
    peers: HashMap<LinkId, (usize, Outbox)>,
    clock: HostClock,
    waits: PreciseWait,
    told: Destinations,
    /// Number of connections per robot.
    connections: Vec<u64>,
    /// Number of owner changes of each robot that have been reported.
    owner_changes: Vec<u64>,
    out: Vec<Outgoing>,
    due: Vec<usize>,
}

impl Executor {
    fn new(robots: Vec<Body>, told: Destinations, waits: PreciseWait) -> Self {
        for (figures, robot) in told.figures.robots().iter().zip(&robots) {
            figures.note(robot.machine().counts(), robot.machine().hardware_answers());
        }
        Self {
            wakeup_of: vec![None; robots.len()],
            connections: vec![0; robots.len()],
            owner_changes: vec![0; robots.len()],
            robots,
            wakeups: BTreeSet::new(),
            peers: HashMap::new(),
            clock: HostClock::anchored(),
            waits,
            told,
            out: Vec::new(),
            due: Vec::new(),
        }
    }

    fn run(mut self, inbox: &flume::Receiver<Order>) {
        loop {
            let next = self.wakeups.first().map(|(at, _)| *at);
            let deadline = next.map(|at| self.clock.instant_of(at));
            let woken = match (next, deadline) {
                (Some(at), Some(deadline)) if !self.moves_soon(at) => {
                    self.waits.wait_roughly(inbox, deadline)
                }
                _ => self.waits.wait(inbox, deadline),
            };
            match woken {
                Woken::Deadline => self.advance_due(),
                Woken::Message(Order::Stop) => return self.shut_down(),
                Woken::Closed => return self.shut_down(),
                Woken::Message(order) => self.obey(order),
            }
        }
    }

    /// Whether a robot moves at most [`MOVES_SOON`] after `at`, the instant of the next due event. The thread must then wait precisely.
    /// If not, the due events are only deliveries of messages on simulated networks.
    fn moves_soon(&self, at: Timestamp<HostTime>) -> bool {
        let by = at + MOVES_SOON;
        let mut due = self.wakeups.iter().take_while(|(at, _)| *at <= by);
        due.any(|(_, robot)| self.robots[*robot].moves_by(by))
    }

    fn obey(&mut self, order: Order) {
        match order {
            Order::Open { robot, link, outbox } => {
                // An idle host has no scheduled events, so its clock may follow the system clock again.
                if self.robots.len() <= 64 && self.robots.iter().all(Body::is_idle) {
                    self.clock = HostClock::anchored();
                }
                if let Some(audit) = &self.told.audit {
                    audit.connected(robot, outbox.peer());
                }
                self.peers.insert(link, (robot, outbox));
                self.connected(robot, Change::Opened);
                self.advance(robot);
            }
            Order::Input { robot, link, input, permit } => {
                if matches!(input, Input::LinkDown) {
                    self.forget(link);
                } else if !self.peers.contains_key(&link) {
                    // The link was closed while the input was on its way.
                    return;
                }
                self.audit_request(link, &input);
                let now = self.clock.now();
                self.robots[robot].receive(now, link, input);
                self.advance(robot);
                drop(permit);
            }
            #[cfg(any(feature = "sealed", feature = "tls"))]
            Order::Bar { robot, serial, why } => self.bar(robot, &serial, why),
            Order::Look { robot, permit } => {
                self.robots[robot].look(self.clock.now());
                self.advance(robot);
                let _gone = permit.send(());
            }
            Order::Hardware { robot, news } => {
                self.robots[robot].hear(self.clock.now(), news);
                self.advance(robot);
            }
            Order::Beat { answer } => drop(answer.send(())),
            Order::Stop => {}
        }
    }

    /// Ends the commands and closes the links of the peers whose key is no longer valid.
    #[cfg(any(feature = "sealed", feature = "tls"))]
    fn bar(&mut self, robot: usize, serial: &Label, why: String) {
        let now = self.clock.now();
        // The key may have been used on links that no longer exist.
        let no_link = LinkId(u64::MAX);
        let reason = why.clone();
        self.robots[robot].receive(now, no_link, Input::Barred { serial: serial.clone(), why });
        self.advance(robot);
        let has_key = |peer: &Peer| peer.proof().and_then(|proof| proof.serial.as_ref()) == Some(serial);
        let links = self.peers.iter().filter(|(_, (of, outbox))| *of == robot && has_key(outbox.peer()));
        let links: Vec<_> = links.map(|(link, _)| *link).collect();
        if let Some(audit) = &self.told.audit {
            let peer = links.first().and_then(|link| self.peers.get(link)).map(|(_, outbox)| outbox.peer());
            audit.barred(robot, peer, serial.as_str(), &reason);
        }
        for link in links {
            if let Some(outbox) = self.forget(link) {
                self.told.refusals.note(Reason::KeyInvalid, outbox.peer());
                outbox.close();
            }
        }
    }

    /// Notes a request for the audit trail.
    fn audit_request(&self, link: LinkId, input: &Input) {
        let Some(audit) = &self.told.audit else { return };
        let request = match input {
            Input::Message(Message::ControlRequest(request)) | Input::Hashed(request, _) => request,
            _ => return,
        };
        if let Some((robot, outbox)) = self.peers.get(&link) {
            audit.request(*robot, outbox.peer(), request);
        }
    }

    /// Removes a link that is closed or must no longer be used.
    fn forget(&mut self, link: LinkId) -> Option<Outbox> {
        let (robot, outbox) = self.peers.remove(&link)?;
        self.connected(robot, Change::Closed);
        Some(outbox)
    }

    fn connected(&mut self, robot: usize, change: Change) {
        let connections = &mut self.connections[robot];
        *connections = match change {
            Change::Opened => *connections + 1,
            Change::Closed => connections.saturating_sub(1),
        };
        self.told.figures.robots()[robot].has_connections(*connections);
    }

    /// Brings hardware to rest. Afterwards the drivers' threads end, because their channels are dropped here.
    fn shut_down(mut self) {
        for robot in 0..self.robots.len() {
            self.robots[robot].shut_down(self.clock.now());
            self.advance(robot);
        }
    }

    /// Moves all due robots first, and sends their messages only afterwards, so that no robot's start waits for another robot's report.
    fn advance_due(&mut self) {
        let now = self.clock.now();
        if let Some((at, _)) = self.wakeups.first() {
            self.told.figures.wake_up.add(now - *at);
        }
        let mut due = std::mem::take(&mut self.due);
        due.extend(self.wakeups.iter().take_while(|(at, _)| *at <= now).map(|(_, robot)| *robot));
        for robot in &due {
            let now = self.clock.now();
            self.robots[*robot].advance_movements(now);
            self.robots[*robot].post(&self.clock);
        }
        // Sending messages wakes other threads, in this process and in the scheduler. Another process may need this core to move its
        // robots.
        if due.iter().any(|robot| self.robots[*robot].has_log()) {
            let next = self.wakeups.iter().find(|(at, _)| *at > now);
            self.waits.let_others_move(next.map(|(at, _)| self.clock.instant_of(*at)));
        }
        for robot in due.drain(..) {
            self.advance(robot);
        }
        // Keeps the emptied vector to reuse its allocation.
        self.due = due;
    }

    fn advance(&mut self, robot: usize) {
        let now = self.clock.now();
        self.robots[robot].advance(now, &mut self.out);
        self.robots[robot].post(&self.clock);
        let log = self.robots[robot].take_log();
        let (figures, machine) = (&self.told.figures.robots()[robot], self.robots[robot].machine());
        figures.note(machine.counts(), machine.hardware_answers());
        if let (Some(audit), false) = (&self.told.audit, log.is_empty()) {
            audit.values(robot, &log);
        }
        if !log.is_empty() {
            figures.stepped(log.iter().filter(|entry| entry.is_a_step()).count() as u64);
        }
        if let (Some(sink), false) = (&self.told.log, log.is_empty()) {
            sink.add(robot, log);
        }
        let next = self.robots[robot].next_wakeup();
        let known = std::mem::replace(&mut self.wakeup_of[robot], next);
        known.map(|at| self.wakeups.remove(&(at, robot)));
        next.map(|at| self.wakeups.insert((at, robot)));
        self.tell_owner(robot);
        self.send_out();
    }

    /// Publishes a change of the robot's owner. This happens before the response that grants the claim is sent, so that the messages that
    /// follow the response can be treated as the owner's.
    fn tell_owner(&mut self, robot: usize) {
        let (changes, claimant) = self.robots[robot].machine().last_claimant();
        if self.owner_changes[robot] != changes {
            self.owner_changes[robot] = changes;
            if let Some(audit) = &self.told.audit {
                let machine = self.robots[robot].machine();
                let owner =
                    self.peers.iter().find(|(link, (of, _))| *of == robot && machine.is_owner(**link));
                audit.owner(robot, claimant, owner.map(|(_, (_, outbox))| outbox.peer()));
            }
            self.told.owners[robot].send_replace(claimant.cloned());
        }
    }

    fn send_out(&mut self) {
        let mut out = std::mem::take(&mut self.out);
        for outgoing in out.drain(..) {
            match outgoing {
                Outgoing::Message { link, message } => {
                    let Some((robot, outbox)) = self.peers.get(&link) else { continue };
                    if let Some(audit) = &self.told.audit {
                        audit.response(*robot, outbox.peer(), &message);
                    }
                    if is_busy(&message) {
                        self.told.refusals.note(Reason::Busy, outbox.peer());
                    }
                    let is_owner = || self.robots[*robot].machine().is_owner(link);
                    if !outbox.say(message, is_owner) {
                        self.told.refusals.note(Reason::Unread, outbox.peer());
                        self.forget(link);
                    }
                }
                Outgoing::Close { link } => {
                    if let Some(outbox) = self.forget(link) {
                        outbox.close();
                    }
                }
            }
        }
        self.out = out;
    }
}

/// Whether the message refuses a request because the robot is busy.
fn is_busy(message: &Message) -> bool {
    let error = match message {
        Message::ControlResponse(response) => &response.error,
        Message::AvailabilityResponse(response) => &response.error,
        Message::InquiryResponse(response) => &response.error,
        _ => return false,
    };
    error.as_ref().is_some_and(|error| error.code == ErrorCode::Busy)
}

#[cfg(test)]
mod tests {
    use rustix::thread::{CapabilitySet, CapabilitySets};

    use super::*;
    use crate::host::outbox::outbox;
    use crate::host::tests::{arms, paper};
    use crate::host::{Host, HostOptions};
    use crate::peer::Peer;
    use crate::simulated::Settings;

    fn executor(robots: usize) -> Executor {
        let told = Destinations {
            log: None,
            owners: (0..robots).map(|_| watch::channel(None).0).collect(),
            refusals: Arc::default(),
            figures: Arc::new(Figures::of(robots)),
            audit: None,
        };
        let bodies =
            arms(robots, &Settings::default()).into_iter().map(|robot| Body::Simulated(Box::new(robot)));
        Executor::new(bodies.collect(), told, PreciseWait::new(&Scheduling::of_this_thread(Realtime::Off)))
    }

    fn is_connected(executor: &mut Executor, link: u64) {
        let (outbox, _) = outbox(Peer::in_process());
        executor.obey(Order::Open { robot: 0, link: LinkId(link), outbox });
    }

    #[test]
    fn new_connection_resets_the_clock_of_few_idle_robots_to_system_time() {
        let hour = Span::from_millis(3_600_000);
        for (robots, is_busy, follows) in
            [(1, false, true), (64, false, true), (65, false, false), (2, true, false)]
        {
            let mut executor = executor(robots);
            is_connected(&mut executor, 0);
            if is_busy {
                let input = Input::read(paper(600_000.0));
                executor.obey(Order::Input { robot: 0, link: LinkId(0), input, permit: None });
            }
            executor.clock = executor.clock.ahead_by(hour);
            is_connected(&mut executor, 1);
            let ahead = Span::ZERO - executor.clock.system_ahead();
            assert_eq!(ahead < hour / 2, follows, "{robots} robots, busy: {is_busy}, {ahead} ahead");
        }
    }

    /// Starts one host for each kind of scheduling request. Returns the request, the granted scheduling, and whether the host runs.
    fn granted() -> Vec<(Realtime, Scheduling, bool)> {
        let start = |realtime| {
            let options = HostOptions::default().with_realtime(realtime);
            match Host::start(arms(1, &Settings::default()), options) {
                Ok(host) => (realtime, host.scheduling().clone(), true),
                Err(HostError::Realtime(scheduling)) => (realtime, scheduling, false),
                Err(other) => panic!("{other}"),
            }
        };
        [Realtime::Off, Realtime::Auto, Realtime::Required].map(start).to_vec()
    }

    /// Like `granted`, but without the capability `CAP_SYS_NICE`. Real-time scheduling is then granted only if a resource limit permits
    /// it.
    fn granted_less() -> Vec<(Realtime, Scheduling, bool)> {
        let thread = std::thread::spawn(|| {
            let found = rustix::thread::capabilities(None).unwrap();
            let without = |set: CapabilitySet| set - CapabilitySet::SYS_NICE;
            let (effective, permitted) = (without(found.effective), without(found.permitted));
            let sets = CapabilitySets { effective, permitted, ..found };
            rustix::thread::set_capabilities(None, sets).unwrap();
            granted()
        });
        thread.join().unwrap()
    }

    #[test]
    fn host_starts_without_denied_permissions_unless_they_are_required() {
        for (realtime, scheduling, runs) in granted().into_iter().chain(granted_less()) {
            let may_run = realtime != Realtime::Required || !scheduling.lacks_something();
            assert_eq!(runs, may_run, "{realtime:?}: {scheduling}");
        }
    }
}
