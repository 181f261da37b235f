//! Model of what a device must do over time, independent of the device's state machine: its accepted orders, their progress, and their
//! leases.

use std::collections::{BTreeMap, HashMap};

use downbeat_robot::LinkId;
use urrcp::{
    Command, ControlParameters, ControlRequest, ControlType, Device, Interpolation, Millis, RequestId, Robot,
    Server, SessionId, Setpoint, Span, Step, StopCondition, Timestamp,
};

/// Maximum delay of a command's start. A robot drops a command that would start with a longer delay, as `docs/protocol.md` requires.
pub(crate) const START_LATE_MAX: Span = Span::from_millis(50);

type Now = Timestamp<Robot>;

/// Peer whose messages renew a lease: a link on which no session was named, or a session, whichever link it uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Party {
    Link(LinkId),
    Session(usize),
}

/// The party of each link (the peer whose messages renew leases), and the time of each party's last message.
#[derive(Debug, Default)]
pub(crate) struct Heard {
    of_link: HashMap<LinkId, Party>,
    of_session: HashMap<SessionId, Party>,
    last: HashMap<Party, Now>,
}

impl Heard {
    /// Records a message, and returns the party (a session or a link) that sent it.
    pub(crate) fn message(&mut self, now: Now, link: LinkId, session: Option<&SessionId>) -> Party {
        let party = match session {
            None => self.of_link.get(&link).copied().unwrap_or(Party::Link(link)),
            Some(session) => self.session(link, session),
        };
        self.last.insert(party, now);
        party
    }

    /// Returns the party of a session, and assigns the link to this party. The first session on a link shares the link's own party; each
    /// later session becomes a separate party.
    fn session(&mut self, link: LinkId, session: &SessionId) -> Party {
        let fresh = if self.of_session.values().any(|party| *party == Party::Link(link)) {
            Party::Session(self.of_session.len())
        } else {
            Party::Link(link)
        };
        let party = *self.of_session.entry(session.clone()).or_insert(fresh);
        self.of_link.insert(link, party);
        party
    }

    /// Returns all sessions that any message has named.
    pub(crate) fn sessions(&self) -> impl Iterator<Item = &SessionId> {
        self.of_session.keys()
    }

    fn ends(&self, party: Party, accepted: Now, silence: Option<Millis>) -> Option<Now> {
        let heard = self.last.get(&party).copied().unwrap_or(accepted);
        Some(heard.max(accepted) + silence?.span())
    }
}

/// An accepted command whose end the robot has not reported.
#[derive(Debug)]
pub(crate) struct Order {
    pub(crate) serial: usize,
    pub(crate) id: Option<RequestId>,
    pub(crate) session: Option<SessionId>,
    pub(crate) party: Party,
    accepted: Now,
    pub(crate) start: Now,
    pub(crate) steps: Vec<Step>,
    pub(crate) is_script: bool,
    condition: Option<StopCondition>,
    /// Time after which the lease that applies before the start has ended in any case. `None`: no such limit.
    pending_until: Option<Now>,
    /// Number of steps whose values have been set.
    pub(crate) done: usize,
    /// Whether the start time of the command has been reached.
    pub(crate) began: bool,
    /// Whether the robot has reported the start of the command.
    pub(crate) started: bool,
}

impl Order {
    pub(crate) fn new(serial: usize, now: Now, party: Party, request: &ControlRequest) -> Self {
        let steps = match &request.command {
            Command::Set(setpoint) => {
                vec![Step { offset: Millis::ZERO, setpoint: setpoint.clone(), stop_condition: None }]
            }
            Command::Script(script) => script.steps().to_vec(),
            Command::ReadSensor | Command::Unknown(_) => Vec::new(),
        };
        Self {
            serial,
            id: request.request_id.clone(),
            session: request.session.clone(),
            party,
            accepted: now,
            start: start_of(now, request),
            steps,
            is_script: matches!(request.command, Command::Script(_)),
            condition: request.stop_condition,
            pending_until: request.pending_until,
            done: 0,
            began: false,
            started: false,
        }
    }

    pub(crate) fn end(&self) -> Now {
        self.start + self.steps.last().map_or(Span::ZERO, |step| step.offset.span())
    }

    pub(crate) fn time_of(&self, step: usize) -> Option<Now> {
        Some(self.start + self.steps.get(step)?.offset.span())
    }

    pub(crate) fn is_done(&self) -> bool {
        self.done == self.steps.len()
    }

    /// Whether an empty script cancels the command. With `from`, such a script cancels the commands that start at `from` or later and
    /// have not started; with `None`, it cancels all.
    pub(crate) fn falls(&self, from: Option<Now>) -> bool {
        from.is_none_or(|from| !self.began && self.start >= from)
    }

    pub(crate) fn next_event(&self) -> Option<Now> {
        if self.began { self.time_of(self.done) } else { Some(self.start) }
    }

    /// Returns the end of the lease that applies before the start. `None`: the lease does not end.
    pub(crate) fn pending_ends(&self, heard: &Heard) -> Option<Now> {
        let silent = heard.ends(self.party, self.accepted, self.condition.and_then(|lease| lease.pending));
        silent.into_iter().chain(self.pending_until).min()
    }

    /// Returns the end of the lease that applies after `done` steps have been set. `None`: the lease does not end.
    pub(crate) fn running_ends(&self, heard: &Heard, done: usize) -> Option<Now> {
        let own = done.checked_sub(1).and_then(|step| self.steps.get(step)?.stop_condition);
        heard.ends(self.party, self.accepted, own.or(self.condition).and_then(|lease| lease.running))
    }

    /// Limits the lease that applies before the start: to a silence of `pending`, and to an end at `until`. `None` leaves a limit
    /// unchanged.
    pub(crate) fn limit(&mut self, pending: Option<Millis>, until: Option<Now>) {
        self.pending_until = until.or(self.pending_until);
        let Some(pending) = pending else { return };
        let condition = self.condition.unwrap_or_default();
        let shortest = condition.pending.filter(|own| own.get() <= pending.get()).unwrap_or(pending);
        self.condition = Some(StopCondition { pending: Some(shortest), ..condition });
    }

    /// Whether the command may have started: its start was at most `START_LATE_MAX` ago, and its lease was in force at the start.
    pub(crate) fn begins_by(&self, now: Now, heard: &Heard) -> bool {
        let in_force = self.pending_ends(heard).is_none_or(|end| end > self.start);
        self.start <= now && now - self.start <= START_LATE_MAX && in_force
    }

    /// Whether the command's lease ended at or before its start.
    fn is_over_before_its_start(&self, now: Now, heard: &Heard) -> bool {
        !self.began && self.must_end(heard).is_some_and(|end| end <= now && end <= self.start)
    }

    /// Returns when the robot must end the command: when its lease ends, or at the command's next event if the lease that applies after
    /// this event has ended by then.
    pub(crate) fn must_end(&self, heard: &Heard) -> Option<Now> {
        let current =
            if !self.began { self.pending_ends(heard) } else { self.running_ends(heard, self.done) };
        let sets_a_step = self.began || self.time_of(0) == Some(self.start);
        let after = self.running_ends(heard, self.done + usize::from(sets_a_step));
        let next = self.next_event().filter(|at| after.is_some_and(|end| end <= *at));
        current.into_iter().chain(next).min()
    }
}

/// Returns the start time of a request that is received at `now`.
pub(crate) fn start_of(now: Now, request: &ControlRequest) -> Now {
    request.starts_at().map_or(now, Timestamp::assume_clock)
}

/// Returns the start of a request that is an empty script with a start after `now`: it cancels commands that start then or later. `None`
/// for other requests.
pub(crate) fn cancels_from(now: Now, request: &ControlRequest) -> Option<Now> {
    let empty = matches!(&request.command, Command::Script(script) if script.is_empty());
    Some(start_of(now, request)).filter(|from| empty && *from > now)
}

/// Rates (such as speeds) that continue after the end of their command, and the command's lease, which still covers them.
#[derive(Debug)]
pub(crate) struct Guard {
    pub(crate) id: Option<RequestId>,
    pub(crate) party: Party,
    accepted: Now,
    silence: Option<Millis>,
    rates: Vec<ControlType>,
}

impl Guard {
    pub(crate) fn must_end(&self, heard: &Heard) -> Option<Now> {
        heard.ends(self.party, self.accepted, self.silence)
    }
}

/// The last movement of a signal (one control type of a device), from its start to its target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SignalMovement {
    pub(crate) from: f64,
    pub(crate) since: Now,
    pub(crate) to: f64,
    pub(crate) until: Now,
    /// Whether the speed of the signal changes during the movement.
    pub(crate) is_slowing: bool,
}

impl SignalMovement {
    pub(crate) const fn at(value: f64, now: Now) -> Self {
        Self { from: value, since: now, to: value, until: now, is_slowing: false }
    }

    /// Returns the signal's value at `now`. `None` while the signal's speed changes.
    pub(crate) fn value(&self, now: Now) -> Option<f64> {
        if now >= self.until {
            return Some(self.to);
        }
        let part = (now - self.since).as_millis_f64() / (self.until - self.since).as_millis_f64();
        (!self.is_slowing).then_some(self.from * (1.0 - part) + self.to * part)
    }

    pub(crate) fn moves(&self, now: Now) -> bool {
        now < self.until
    }
}

/// Model of one device, derived from its orders and movements.
#[derive(Debug)]
pub(crate) struct DeviceModel {
    pub(crate) spec: Device,
    /// Accepted commands that have not ended, in the order of their execution.
    pub(crate) queue: Vec<Order>,
    pub(crate) guards: Vec<Guard>,
    /// Guards (leases of continuing rates) that a stop has just ended. The robot's reports about their end follow.
    pub(crate) released: Vec<Guard>,
    /// Last movement of each signal, by control type.
    pub(crate) ways: BTreeMap<ControlType, SignalMovement>,
    /// Sending time of a message: stops have cancelled all messages that were sent up to this time, by any sender.
    pub(crate) taken_back: Option<Timestamp<Server>>,
    /// Sending time of a message: stops may have cancelled messages that were sent up to this time, but none that were sent later.
    pub(crate) taken_back_at_most: Option<Timestamp<Server>>,
}

impl DeviceModel {
    pub(crate) fn new(spec: Device) -> Self {
        let (queue, guards, released) = (Vec::new(), Vec::new(), Vec::new());
        Self {
            spec,
            queue,
            guards,
            released,
            ways: BTreeMap::new(),
            taken_back: None,
            taken_back_at_most: None,
        }
    }

    pub(crate) fn insert(&mut self, order: Order) {
        let key = (order.start, order.end());
        let place = self.queue.partition_point(|held| (held.start, held.end()) <= key);
        self.queue.insert(place, order);
    }

    /// Records a movement of a signal. The lease of the signal's previous command no longer covers the signal.
    pub(crate) fn drive(&mut self, control_type: ControlType, way: SignalMovement) {
        self.ways.insert(control_type, way);
        for guard in &mut self.guards {
            guard.rates.retain(|rate| *rate != control_type);
        }
        self.guards.retain(|guard| !guard.rates.is_empty());
    }

    /// Records that the order at index `at` has set its last step. The order's lease still covers the rates (such as speeds) that
    /// continue.
    pub(crate) fn guard_what_goes_on(&mut self, at: usize) {
        let order = &self.queue[at];
        let last = order.steps.last().and_then(|step| step.stop_condition);
        let silence = last.or(order.condition).and_then(|lease| lease.running);
        let mut rates: Vec<_> = order.steps.iter().map(|step| step.setpoint.control_type).collect();
        rates.sort_unstable();
        rates.dedup();
        rates.retain(|rate| {
            let way = self.ways.get(rate);
            way.zip(self.rest(*rate)).is_some_and(|(way, rest)| way.to != rest)
        });
        if silence.is_some() && !rates.is_empty() {
            let (id, party, accepted) = (order.id.clone(), order.party, order.accepted);
            self.guards.push(Guard { id, party, accepted, silence, rates });
        }
    }

    /// Returns the value that a rate (such as a speed) has at rest. `None` if the rate keeps its value.
    pub(crate) fn rest(&self, rate: ControlType) -> Option<f64> {
        match rate {
            ControlType::Speed | ControlType::Acceleration => Some(0.0),
            _ => Some(self.spec.available_control_types.at_rest(rate, 1)?.value),
        }
    }

    /// Returns the time of the device's earliest event: a step, a start, or the end of a lease.
    pub(crate) fn earliest(&self, heard: &Heard) -> Option<Now> {
        let orders = self.queue.iter().flat_map(|order| [order.next_event(), order.must_end(heard)]);
        orders.chain(self.guards.iter().map(|guard| guard.must_end(heard))).flatten().min()
    }

    /// Whether a lease of a running command, or of a rate (such as a speed) that continues after its command, has ended.
    pub(crate) fn running_lease_is_over(&self, now: Now, heard: &Heard) -> bool {
        let guards = self.guards.iter().chain(&self.released).map(|guard| guard.must_end(heard));
        let running = self.queue.iter().filter(|order| order.began && !order.is_done());
        running.map(|order| order.must_end(heard)).chain(guards).flatten().any(|end| end <= now)
    }

    /// Returns the earliest start among the orders whose lease ended before they started. All orders that start then or later are
    /// cancelled.
    pub(crate) fn falls_from(&self, now: Now, heard: &Heard) -> Option<Now> {
        let over = self.queue.iter().filter(|order| order.is_over_before_its_start(now, heard));
        over.map(|order| order.start).min()
    }

    /// If the device holds its value between steps, marks orders as begun whose start time has been reached and whose first value is due
    /// later.
    pub(crate) fn begin_untold(&mut self, now: Now, heard: &Heard) {
        let falls = self.falls_from(now, heard);
        let untold = self.spec.interpolation == Interpolation::Hold;
        for order in self.queue.iter_mut().filter(|order| untold && !order.began) {
            let is_later = order.time_of(0) > Some(order.start);
            order.began =
                is_later && order.begins_by(now, heard) && falls.is_none_or(|from| order.start < from);
        }
    }

    /// Whether the outputs show that the device comes to rest, because its speed is set to zero.
    pub(crate) fn must_rest(&self) -> bool {
        self.spec.primary_control_type() == Some(ControlType::Speed)
    }

    /// Whether a request may set this value: the device has its control type, and the value is within its limits and a multiple of its
    /// granularity.
    pub(crate) fn can_take(&self, setpoint: &Setpoint) -> bool {
        match self.spec.available_control_types.get(setpoint.control_type) {
            Some(ControlParameters::Motion(limits)) => {
                let steps = setpoint.value / limits.granularity;
                setpoint.more.is_empty()
                    && (limits.min_value..=limits.max_value).contains(&setpoint.value)
                    && (steps - steps.round()).abs() <= 1e-6
            }
            Some(ControlParameters::Custom(_)) => setpoint.values().all(f64::is_finite),
            _ => false,
        }
    }
}
