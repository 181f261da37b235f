//! A frame of the live display: the text that shows a model at an instant, in a given number of columns and rows.

use downbeat_scripts::shown::shown;
use downbeat_scripts::{Act, PlannedCue, Wait, Way};
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span as Piece};
use ratatui::widgets::{Cell, Row as TableRow, Table, Widget};
use urrcp::{Server, Span, Timestamp};

use super::model::{Confirmed, Decided, Model, Phase, RobotState, Row, ShownAct, Stage};
use crate::show::local::{seconds_of_day, time_as_of};

const BOLD: Style = Style::new().add_modifier(Modifier::BOLD);
const DIM: Style = Style::new().add_modifier(Modifier::DIM);
const RED: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
const YELLOW: Style = Style::new().fg(Color::Yellow);
const GREEN: Style = Style::new().fg(Color::Green);
const CYAN: Style = Style::new().fg(Color::Cyan);

/// Whether the help for the keys is shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Help {
    Hidden,
    Shown,
}

/// The contents of the display at one instant.
pub(super) struct Frame {
    head: Vec<Line<'static>>,
    rows: Vec<Row>,
    /// How long the current act has played. `None` if no act plays.
    played: Option<Span>,
    foot: Vec<Line<'static>>,
}

impl Frame {
    /// Creates a frame for the model at the instant `now`. It has at most `rows` rows and is `columns` wide.
    pub(super) fn of(model: &Model, now: Timestamp<Server>, help: Help, columns: u16, rows: u16) -> Self {
        let mut head = vec![title(model, now, usize::from(columns))];
        head.extend(act_lines(model, now, usize::from(columns)));
        let keys = keys(model, help);
        let room = usize::from(rows).saturating_sub(head.len() + 1 + keys.len()).max(1);
        let (rows, folded) = folded(&model.rows, room);
        let foot = folded.into_iter().chain(keys).collect();
        let played = match model.acts.first().map(|act| &act.stage) {
            Some(Stage::Decided(decided)) if now >= decided.start => Some(now - decided.start),
            _ => None,
        };
        Self { head, rows, played, foot }
    }

    pub(super) fn height(&self) -> u16 {
        let lines = self.head.len() + 1 + self.rows.len() + self.foot.len();
        u16::try_from(lines).unwrap_or(u16::MAX)
    }

    pub(super) fn draw(&self, area: Rect, buffer: &mut Buffer) {
        let mut y = area.y;
        let bottom = area.y + area.height;
        let mut line = |line: &Line<'_>, y: &mut u16| {
            if *y < bottom {
                buffer.set_line(area.x, *y, line, area.width);
            }
            *y += 1;
        };
        self.head.iter().for_each(|text| line(text, &mut y));
        let table_at = y;
        y += u16::try_from(self.rows.len() + 1).unwrap_or(u16::MAX);
        self.foot.iter().for_each(|text| line(text, &mut y));
        let height = u16::try_from(self.rows.len() + 1).unwrap_or(u16::MAX);
        let place = Rect { x: area.x, y: table_at, width: area.width, height }.intersection(area);
        self.table(area.width).render(place, buffer);
    }

    fn table(&self, columns: u16) -> Table<'_> {
        let header = ["robot", "state", "steps", "clock", "latest report"];
        let longest = self.rows.iter().map(|row| Line::from(row.robot.as_str()).width()).max().unwrap_or(0);
        // The column is as wide as the longest name, but at most a quarter of the terminal.
        let name = u16::try_from(longest.max(5)).unwrap_or(u16::MAX).min((columns / 4).max(8));
        let widths = [name, 10, 9, 11].map(Constraint::Length).into_iter().chain([Constraint::Fill(1)]);
        let rows = self.rows.iter().map(|row| robot_row(row, self.played));
        Table::new(rows, widths).header(TableRow::new(header).style(DIM)).column_spacing(1)
    }
}

fn robot_row(row: &Row, played: Option<Span>) -> TableRow<'_> {
    let style = match row.state {
        RobotState::Failed | RobotState::LinkLost => RED,
        RobotState::Stopping | RobotState::LeftOut => YELLOW,
        RobotState::Playing | RobotState::AtRest => GREEN,
        RobotState::Accepted => CYAN,
        RobotState::Greeting | RobotState::Ready | RobotState::Ended => Style::new(),
    };
    let steps = match (row.steps_planned, played) {
        (0, _) => "-".to_owned(),
        // Robots report steps at the end of a script. Until then, the count comes from the plan.
        (planned, Some(played)) if row.state == RobotState::Playing => {
            format!("~{}/{planned}", row.steps_by(played))
        }
        (planned, _) if row.may_have_done_more() => format!("{}+/{planned}", row.steps_done),
        (planned, _) => format!("{}/{planned}", row.steps_done),
    };
    TableRow::new([
        Cell::from(row.robot.as_str()),
        Cell::from(Piece::styled(row.state.text(), style)),
        Cell::from(steps),
        Cell::from(row.clock.as_str()),
        Cell::from(row.word.as_str()),
    ])
}

/// Returns at most `room` rows, including a summary of the omitted ones, if any. If rows are omitted, the robots with the worst states
/// come first.
fn folded(rows: &[Row], room: usize) -> (Vec<Row>, Option<Line<'static>>) {
    if rows.len() <= room {
        return (rows.to_vec(), None);
    }
    let mut order: Vec<&Row> = rows.iter().collect();
    order.sort_by_key(|row| row.state);
    let (first, rest) = order.split_at(room.saturating_sub(1));
    let mut counts: Vec<(RobotState, usize)> = Vec::new();
    for row in rest {
        match counts.last_mut() {
            Some((state, count)) if *state == row.state => *count += 1,
            _ => counts.push((row.state, 1)),
        }
    }
    let counts: Vec<_> = counts.iter().map(|(state, count)| format!("{count} {}", state.text())).collect();
    let text = format!("and {} more: {}", rest.len(), counts.join(", "));
    (first.iter().map(|row| (*row).clone()).collect(), Some(Line::styled(text, DIM)))
}

/// Formats a duration: `1.4 s`, `1:05 min`, `2:01:05 h`.
fn length(span: Span) -> String {
    let seconds = span.as_millis_f64().max(0.0) / 1_000.0;
    let whole = seconds as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3_600 => format!("{}:{:02} min", whole / 60, whole % 60),
        _ => format!("{}:{:02}:{:02} h", whole / 3_600, whole / 60 % 60, whole % 60),
    }
}

/// Returns the title line: the scenario, the act and the act's state. If there is room, the time of day and the mission's elapsed time
/// are at the right.
fn title(model: &Model, now: Timestamp<Server>, columns: usize) -> Line<'static> {
    let mut pieces = vec![Piece::styled(shown(&model.choreography.scenario).into_owned(), BOLD)];
    let front = model.acts.first();
    if let Some(act) = front.filter(|_| model.choreography.acts.len() > 1) {
        pieces.push(Piece::raw(format!("  act `{}`", shown(&act.name))));
        if let Some(index) = act.index {
            pieces.push(Piece::styled(format!(" ({} of {})", index + 1, model.choreography.acts.len()), DIM));
        }
    }
    let (doing, style) = doing(model, now);
    pieces.push(Piece::raw("  "));
    pieces.push(Piece::styled(doing, style));
    let clock = format!("{}, running for {}", seconds_of_day(now), length(now - model.began));
    let used: usize = pieces.iter().map(Piece::width).sum();
    if used + 2 + clock.len() <= columns {
        pieces.push(Piece::raw(" ".repeat(columns - used - clock.len())));
        pieces.push(Piece::styled(clock, DIM));
    }
    Line::from(pieces)
}

fn doing(model: &Model, now: Timestamp<Server>) -> (&'static str, Style) {
    match (&model.phase, model.acts.first().map(|act| &act.stage)) {
        (Phase::Stopping(_), _) => ("STOPPING", RED),
        (Phase::Performing, Some(_)) if model.goes_home() => ("GOING HOME", RED),
        (Phase::Greeting, _) => ("checking the robots", CYAN),
        (Phase::Performing, None) => ("between acts", Style::new()),
        (Phase::Performing, Some(Stage::Waiting { .. })) => ("waiting", YELLOW),
        (Phase::Performing, Some(Stage::Preparing { .. })) => ("preparing", CYAN),
        (Phase::Performing, Some(Stage::Decided(decided))) if now < decided.start => ("starting", CYAN),
        (Phase::Performing, Some(Stage::Decided(_))) => ("playing", GREEN),
    }
}

fn act_lines(model: &Model, now: Timestamp<Server>, columns: usize) -> Vec<Line<'static>> {
    let mut lines = Vec::new();
    if let Phase::Stopping(reason) = &model.phase {
        lines.push(Line::from(vec![Piece::styled("reason  ", DIM), Piece::raw(reason.clone())]));
        let failed = |row: &&Row| row.state == RobotState::Failed && row.stop == Confirmed::NotYet;
        let left = model.rows.iter().filter(|row| row.state == RobotState::Stopping || failed(row)).count();
        let text = match (left, model.rows.iter().find(failed)) {
            (0, _) => "every robot that was moving has confirmed the stop".to_owned(),
            (1, Some(row)) => {
                format!("{} has failed without confirming the stop: it may still be moving", row.robot)
            }
            (left, _) => format!("{} not confirmed yet", downbeat_scripts::counted(left, "robot")),
        };
        lines.push(Line::from(vec![Piece::styled("stop    ", DIM), Piece::raw(text)]));
        return lines;
    }
    for (place, shown_act) in model.acts.iter().take(2).enumerate() {
        if place > 0 {
            let name = format!("then    `{}` ", shown(&shown_act.name));
            lines.push(Line::from(vec![Piece::styled(name, DIM), Piece::raw(outlook(shown_act, now))]));
            continue;
        }
        let act = shown_act.index.and_then(|index| model.choreography.acts.get(index));
        match &shown_act.stage {
            Stage::Waiting { .. } => lines.extend(waiting(model, shown_act, act, now)),
            Stage::Preparing { start } => {
                let text = format!("in {}, at {}", length(*start - now), time_as_of(*start, now));
                lines.push(Line::from(vec![Piece::styled("start   ", DIM), Piece::raw(text)]));
            }
            Stage::Decided(decided) => lines.extend(decided_lines(*decided, act, now, columns)),
        }
    }
    lines
}

/// Describes the state of an act that follows the current one.
fn outlook(act: &ShownAct, now: Timestamp<Server>) -> String {
    match &act.stage {
        Stage::Waiting { awaits, until: Some(until), .. } => {
            format!("waits for {awaits} (in {})", length(*until - now))
        }
        Stage::Waiting { awaits, .. } => format!("waits for {awaits}"),
        Stage::Preparing { start } => format!("is being sent, starts in {}", length(*start - now)),
        Stage::Decided(decided) => format!("has been accepted, starts in {}", length(decided.start - now)),
    }
}

fn waiting(
    model: &Model,
    shown_act: &ShownAct,
    act: Option<&Act>,
    now: Timestamp<Server>,
) -> Vec<Line<'static>> {
    let Stage::Waiting { awaits, until, since, reading } = &shown_act.stage else { return Vec::new() };
    // The next line contains the remaining time, so it is omitted here.
    let what = awaits.split(", for ").next().unwrap_or_default();
    let what = Piece::styled(format!("for {what}"), YELLOW);
    let mut lines = vec![Line::from(vec![Piece::styled("waits   ", DIM), what])];
    if let Some(until) = until {
        let text = format!("in {}", length(*until - now));
        lines.push(Line::from(vec![Piece::styled("start   ", DIM), Piece::styled(text, BOLD)]));
        return lines;
    }
    let sensor = act.is_some_and(|act| matches!(act.wait, Wait::Sensor { .. }));
    let mut state = Vec::new();
    match reading {
        Some(Some(value)) => state.push(format!("reading {value}")),
        Some(None) => state.push("no reading".to_owned()),
        None if sensor => state.push("not read yet".to_owned()),
        None => {}
    }
    if let (Some(since), Some((timeout, way))) =
        (since, act.and_then(|act| Some((act.timeout?, act.on_timeout))))
    {
        let then = match way {
            Way::End => "then the mission ends".to_owned(),
            Way::Fail => "then the mission fails".to_owned(),
            Way::Act(other) => {
                let name = model.choreography.acts.get(other).map_or("", |act| act.name.as_str());
                format!("then `{}`", shown(name))
            }
        };
        state.push(format!("{} left, {then}", length(*since + timeout - now)));
    }
    if !state.is_empty() {
        lines.push(Line::from(vec![Piece::styled("now     ", DIM), Piece::raw(state.join("; "))]));
    }
    lines
}

fn decided_lines(
    decided: Decided,
    act: Option<&Act>,
    now: Timestamp<Server>,
    columns: usize,
) -> Vec<Line<'static>> {
    let Decided { start, duration, no_return, committed } = decided;
    let mut lines = Vec::new();
    if now < start {
        let text = format!("in {}, at {}", length(start - now), time_as_of(start, now));
        lines.push(Line::from(vec![Piece::styled("start   ", DIM), Piece::styled(text, BOLD)]));
        let point = match (committed, now < no_return) {
            (_, true) => format!(
                "if a robot fails in the next {}, until {}, no robot will start",
                length(no_return - now),
                time_as_of(no_return, now)
            ),
            (true, false) => "past the point of no return: the robots start".to_owned(),
            (false, false) => {
                "past the point of no return: only a stop can prevent or end the act".to_owned()
            }
        };
        lines.push(Line::from(vec![Piece::styled("decided ", DIM), Piece::raw(point)]));
    } else {
        lines.push(bar(now - start, duration, columns));
    }
    lines.extend(act.map(|act| cue_line(&act.cues, now - start)));
    lines
}

/// Returns a bar that shows the progress of the act, according to the clock.
fn bar(played: Span, duration: Span, columns: usize) -> Line<'static> {
    let part = (played.as_millis_f64() / duration.as_millis_f64().max(1.0)).clamp(0.0, 1.0);
    let times = format!(
        " {} of {}, {} left",
        length(played.min(duration)),
        length(duration),
        length(duration - played)
    );
    let width = columns.saturating_sub(8 + times.len()).clamp(4, 40);
    let full = (part * width as f64).round() as usize;
    Line::from(vec![
        Piece::styled("played  ", DIM),
        Piece::styled("█".repeat(full), GREEN),
        Piece::styled("░".repeat(width - full), DIM),
        Piece::raw(times),
    ])
}

/// Returns the current cues with their remaining times, and the next cue.
fn cue_line(cues: &[PlannedCue], played: Span) -> Line<'static> {
    let under_way: Vec<_> = cues
        .iter()
        .filter(|cue| cue.start <= played && played < cue.end)
        .map(|cue| format!("{} ({})", shown(&cue.name), length(cue.end - played)))
        .collect();
    let next = cues.iter().filter(|cue| cue.start > played).min_by_key(|cue| cue.start);
    let mut pieces = vec![Piece::styled("cue     ", DIM)];
    pieces.push(if under_way.is_empty() {
        Piece::styled("none", DIM)
    } else {
        Piece::styled(under_way.join(", "), BOLD)
    });
    if let Some(next) = next {
        pieces.push(Piece::styled("  next ", DIM));
        pieces.push(Piece::raw(format!("{} in {}", shown(&next.name), length(next.start - played))));
    }
    Line::from(pieces)
}

fn keys(model: &Model, help: Help) -> Vec<Line<'static>> {
    if help == Help::Shown {
        return vec![
            Line::raw("g or Enter  go: starts the act that waits for the operator"),
            Line::raw("s or Ctrl-C stop: every robot slows down and stays where it is"),
            Line::raw("H           home: all robots stop, then move to their default positions"),
            Line::raw("Ctrl-C      twice: exit at once, confirmed or not"),
            Line::raw("~3/5        steps according to the plan; 3/5: as reported; 3+: at least 3"),
            Line::raw("?           hide this help"),
        ];
    }
    let mut pieces = Vec::new();
    let mut key = |key: &'static str, what: &'static str, style: Style| {
        pieces.push(Piece::styled(key, style.add_modifier(Modifier::BOLD)));
        pieces.push(Piece::styled(format!(" {what}   "), style));
    };
    if model.awaits_go() {
        key("g", "go", YELLOW);
    }
    match model.phase {
        Phase::Stopping(_) => {
            key("H", "home", Style::new());
            key("Ctrl-C twice", "exit at once", Style::new());
        }
        _ if model.goes_home() => key("s", "stop", Style::new()),
        _ => {
            key("s", "stop", Style::new());
            key("H", "home", Style::new());
        }
    }
    key("?", "help", Style::new());
    vec![Line::from(pieces)]
}
