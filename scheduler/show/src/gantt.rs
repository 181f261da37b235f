//! The plan of an act as a chart for terminals: cues are bars over time; below them, the chart shows when each robot moves.

use std::ops::RangeInclusive;

use anstyle::{AnsiColor, Style};
use downbeat_scripts::shown::within;
use downbeat_scripts::{Act, FleetRobot, PlannedCue};
use unicode_width::UnicodeWidthStr;
use urrcp::Span;

use super::UNBOUNDED;
use super::busy::{Busy, busy};
use super::ruler::{Tick, length, ticks};
use super::table::wrapped;
use super::text::act_line;

/// Width of the chart, in columns, if it is written to a pipe or a file.
const COLUMNS_OF_A_FILE: usize = 80;
/// Minimum width of a chart in columns. A narrower terminal wraps the chart's lines.
const COLUMNS_MIN: usize = 20;
/// Maximum width of a name in columns. Longer names are cut, even if there is room.
const NAME_MAX: usize = 28;
/// Number of lines after which the ruler is repeated.
const LINES_A_RULER: usize = 40;

const LEGEND: &str = "━ playing or moving, · slack: how much later it could start, ◆ mark, * critical path: determines when \
the act ends";

/// The content of one column of a bar.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Cell {
    Empty,
    Tick,
    Slack,
    Bar,
    Critical,
    Mark,
}

impl Cell {
    const fn character(self) -> char {
        match self {
            Self::Empty => ' ',
            Self::Tick => '┊',
            Self::Slack => '·',
            Self::Bar | Self::Critical => '━',
            Self::Mark => '◆',
        }
    }

    /// Returns the colour of the cell. Colours are removed if the output is not a terminal. The characters are distinguishable without
    /// them.
    fn style(self) -> Style {
        match self {
            Self::Empty | Self::Mark => Style::new(),
            Self::Tick | Self::Slack => Style::new().dimmed(),
            Self::Bar => AnsiColor::Cyan.on_default(),
            Self::Critical => AnsiColor::Yellow.on_default().bold(),
        }
    }
}

/// The layout of a chart: the columns for names and for times.
struct Chart {
    /// Number of columns for names.
    names: usize,
    /// Number of columns for the time from the act's start to its end.
    width: usize,
    /// Duration of the act in milliseconds.
    total: f64,
    ticks: Vec<Tick>,
}

/// Draws the cues of an act in the order of their starts, and the times at which its robots move. The chart is `columns` wide. `robots`
/// are the robots of the plan, in the plan's order.
#[must_use]
pub fn gantt(act: &Act, robots: &[&FleetRobot], columns: usize) -> String {
    let columns = if columns == UNBOUNDED { COLUMNS_OF_A_FILE } else { columns.max(COLUMNS_MIN) };
    let chart = Chart::new(act, columns);
    let mut cues: Vec<_> = act.cues.iter().collect();
    cues.sort_by_key(|cue| cue.start);
    let cues: Vec<_> = cues.into_iter().map(|cue| chart.cue_line(cue)).collect();
    let moves: Vec<_> = busy(act, robots).iter().map(|robot| chart.robot_line(robot)).collect();
    let tables = [chart.section("cue", &cues), chart.section("robot", &moves)];
    let parts = [wrapped(&act_line(act), columns), tables.concat(), wrapped(LEGEND, columns)];
    parts.concat() + "\n"
}

impl Chart {
    fn new(act: &Act, columns: usize) -> Self {
        let cues = act.cues.iter().map(|cue| cue.name.as_str());
        let robots = act.plan.robots.iter().map(|robot| robot.robot.as_str());
        let longest = cues.chain(robots).map(|name| within(name, NAME_MAX).width()).max().unwrap_or(0);
        let names = longest.clamp(5, NAME_MAX.min(columns / 3).max(5));
        let width = columns - names - 3;
        let total = length(act);
        let label = ticks(total, 1).pop().map_or(1, |tick| tick.label.width());
        let mut ticks = ticks(total, width / (label + 5));
        // A tick at the end of the act has no column, so it is omitted.
        ticks.retain(|tick| tick.millis < total);
        Self { names, width, total, ticks }
    }

    /// Returns the column that contains an instant, given in milliseconds.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded by the width")]
    fn column(&self, millis: f64) -> usize {
        ((millis / self.total * self.width as f64).max(0.0) as usize).min(self.width - 1)
    }

    /// Returns the columns that an interval touches, at least one. `start` and `end` are in milliseconds.
    fn columns(&self, start: f64, end: f64) -> RangeInclusive<usize> {
        let first = self.column(start);
        // An interval that ends exactly at the start of a column does not touch that column.
        let last = self.column(end - self.total / self.width as f64 / 1e6);
        first..=last.max(first)
    }

    fn empty(&self) -> Vec<Cell> {
        let mut cells = vec![Cell::Empty; self.width];
        self.ticks.iter().for_each(|tick| cells[self.column(tick.millis)] = Cell::Tick);
        cells
    }

    fn cue_line(&self, cue: &PlannedCue) -> String {
        let [start, end, slack] = [cue.start, cue.end, cue.slack].map(Span::as_millis_f64);
        let mut cells = self.empty();
        if slack > 0.0 {
            cells[self.columns(end, end + slack)].fill(Cell::Slack);
        }
        match (end > start, cue.critical) {
            (false, _) => cells[self.column(start)] = Cell::Mark,
            (true, false) => cells[self.columns(start, end)].fill(Cell::Bar),
            (true, true) => cells[self.columns(start, end)].fill(Cell::Critical),
        }
        self.line(&cue.name, if cue.critical { '*' } else { ' ' }, &cells)
    }

    fn robot_line(&self, robot: &Busy<'_>) -> String {
        let mut cells = self.empty();
        for (start, end) in &robot.moves {
            cells[self.columns(*start, *end)].fill(Cell::Bar);
        }
        self.line(robot.robot.as_str(), ' ', &cells)
    }

    fn line(&self, name: &str, mark: char, cells: &[Cell]) -> String {
        let line = format!("{} {mark} {}", self.padded(name), painted(cells));
        line.trim_end().to_owned() + "\n"
    }

    fn padded(&self, name: &str) -> String {
        let name = within(name, self.names);
        format!("{name}{}", " ".repeat(self.names.saturating_sub(name.width())))
    }

    /// Returns the lines with a ruler above them. The ruler is repeated at regular intervals so that it stays in view.
    fn section(&self, title: &str, lines: &[String]) -> String {
        let ruler = self.ruler(title);
        lines.chunks(LINES_A_RULER).map(|lines| format!("{ruler}{}", lines.concat())).collect()
    }

    /// Returns the line that contains the title and the labels of the ticks. Each label starts next to its tick. Labels that would
    /// overlap another one or exceed the chart are omitted.
    fn ruler(&self, title: &str) -> String {
        let mut line = String::new();
        for tick in &self.ticks {
            let (column, used) = (self.column(tick.millis), line.width());
            let label = format!("┊{}", tick.label);
            if column >= used && column + label.width() <= self.width {
                line += &" ".repeat(column - used);
                line += &label;
            }
        }
        format!("{}   {line}\n", self.padded(title))
    }
}

/// Formats cells in colour. Adjacent equal cells share one colour sequence.
fn painted(cells: &[Cell]) -> String {
    let run = |cells: &[Cell]| {
        let style = cells[0].style();
        let text: String = cells.iter().map(|cell| cell.character()).collect();
        format!("{style}{text}{style:#}")
    };
    cells.chunk_by(PartialEq::eq).map(run).collect()
}

#[cfg(test)]
mod tests;
