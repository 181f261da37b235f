//! The cue sheet of a show: a list of all cues for the people who run it, as a table, as CSV and as a page to print.

use downbeat_scripts::{Choreography, Outline, counted};
use serde::Serialize;
use urrcp::{RobotId, Span};

use super::table::Rows;
use super::waits;

/// Maximum number of robots whose names are listed.
const ROBOTS_NAMED_MAX: usize = 6;

/// The acts and cues of a show.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CueSheet {
    /// The scenario's name.
    pub scenario: String,
    /// The acts, in the order of the file.
    pub acts: Vec<SheetAct>,
}

/// An act with its cues in order of time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SheetAct {
    /// The name of the act; empty if the scenario has no acts.
    pub act: String,
    /// What the act waits for, as text; empty if it does not wait.
    pub waits: String,
    /// The length of the act.
    #[serde(rename = "duration_ms")]
    pub duration: Span,
    /// The cues.
    pub cues: Vec<SheetCue>,
}

/// A line of the cue sheet.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SheetCue {
    /// The numbers of the act and of the cue in the act, from 1: `2.5`. Without acts, only the number of the cue.
    pub number: String,
    /// The start, since the act's start.
    #[serde(rename = "start_ms")]
    pub start: Span,
    /// The time until the last robot of the cue has finished.
    #[serde(rename = "lasts_ms")]
    pub lasts: Span,
    /// The name of the cue.
    pub cue: String,
    /// The robots of the cue.
    pub robots: Vec<RobotId>,
    /// The choreographer's remark.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// The titles of the columns of a cue.
const TITLES: [&str; 6] = ["number", "time", "lasts", "cue", "robots", "note"];

impl CueSheet {
    /// Lists the cues of a choreography. The outline contains the robots of each cue.
    #[must_use]
    pub fn of(choreography: &Choreography, outline: &Outline) -> Self {
        let several = choreography.acts.len() > 1;
        let act = |(index, act): (usize, &downbeat_scripts::Act)| {
            let written = outline.acts.iter().find(|written| written.name == act.name);
            let robots = |cue: usize| written.and_then(|act| act.cues.get(cue)).map(|cue| cue.robots.clone());
            let mut cues: Vec<_> = act.cues.iter().enumerate().collect();
            cues.sort_by_key(|(_, cue)| cue.start);
            let cue = |(place, (cue, planned)): (usize, (usize, &downbeat_scripts::PlannedCue))| SheetCue {
                number: if several {
                    format!("{}.{}", index + 1, place + 1)
                } else {
                    (place + 1).to_string()
                },
                start: planned.start,
                lasts: planned.end - planned.start,
                cue: planned.name.clone(),
                robots: robots(cue).unwrap_or_default(),
                note: planned.text.note.clone(),
            };
            SheetAct {
                act: act.name.clone(),
                waits: waits(&act.wait),
                duration: act.duration(),
                cues: cues.into_iter().enumerate().map(cue).collect(),
            }
        };
        Self {
            scenario: choreography.scenario.clone(),
            acts: choreography.acts.iter().enumerate().map(act).collect(),
        }
    }

    /// Formats the sheet in at most `columns` columns.
    #[must_use]
    pub fn text(&self, columns: usize) -> String {
        let mut text = String::new();
        for act in &self.acts {
            let mut rows = Rows::new(&TITLES, 1);
            act.cues.iter().for_each(|cue| rows.add(cue.cells()));
            if self.acts.len() > 1 {
                text += &format!("{}\n", downbeat_scripts::shown::shown(&act.title(&self.scenario)));
            }
            text += &rows.text(columns);
        }
        text
    }

    /// Formats the sheet as CSV (RFC 4180), with a line of titles.
    #[must_use]
    pub fn csv(&self) -> String {
        let mut lines = vec![csv_line(std::iter::once("act").chain(TITLES))];
        for act in &self.acts {
            let name = if act.act.is_empty() { &self.scenario } else { &act.act };
            let cues = act.cues.iter();
            lines.extend(cues.map(|cue| {
                let cells = cue.cells();
                csv_line(std::iter::once(name.as_str()).chain(cells.iter().map(String::as_str)))
            }));
        }
        lines.concat()
    }

    /// Formats the sheet as a page that fits A4 paper. It needs no network.
    #[must_use]
    pub fn html(&self) -> String {
        let acts: String = self.acts.iter().map(|act| act.html(&self.scenario)).collect();
        let scenario = escaped(&self.scenario);
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<title>{scenario}: cue sheet</title>\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">\n\
             <style>{STYLE}</style>\n</head>\n<body>\n<h1>{scenario}</h1>\n{acts}</body>\n</html>\n"
        )
    }
}

const STYLE: &str = "@page { size: A4; margin: 12mm }
body { max-width: 186mm; margin: 8mm auto; font: 10pt/1.3 sans-serif; color: #000; background: #fff }
h1 { font-size: 15pt; margin: 0 0 3mm } h2 { font-size: 11pt; margin: 5mm 0 1mm }
table { width: 100%; border-collapse: collapse } tr { break-inside: avoid }
th, td { padding: 0.6mm 2mm 0.6mm 0; text-align: left; vertical-align: top; border-bottom: 0.2mm solid #bbb }
th { font-weight: normal; color: #444 } td:nth-child(2), td:nth-child(3) { white-space: nowrap; font-variant-numeric: tabular-nums }
td:nth-child(4) { font-weight: bold } td { overflow-wrap: anywhere }
@media print { body { margin: 0 } }";

impl SheetAct {
    /// The name of the act, its length, and what it waits for.
    fn title(&self, scenario: &str) -> String {
        let name = if self.act.is_empty() { scenario } else { &self.act };
        let waits = if self.waits.is_empty() { String::new() } else { format!(", waits for {}", self.waits) };
        format!("{name}: {}{waits}", clock(self.duration))
    }

    fn html(&self, scenario: &str) -> String {
        let titles: String = TITLES.iter().map(|title| format!("<th>{title}</th>")).collect();
        let cells = |cue: &SheetCue| cue.cells().map(|cell| format!("<td>{}</td>", escaped(&cell))).concat();
        let rows: String = self.cues.iter().map(|cue| format!("<tr>{}</tr>\n", cells(cue))).collect();
        let title = escaped(&self.title(scenario));
        format!(
            "<h2>{title}</h2>\n<table>\n<thead><tr>{titles}</tr></thead>\n<tbody>\n{rows}</tbody>\n</table>\n"
        )
    }
}

impl SheetCue {
    fn cells(&self) -> [String; 6] {
        [
            self.number.clone(),
            clock(self.start),
            clock(self.lasts),
            self.cue.clone(),
            robots_text(&self.robots),
            self.note.clone().unwrap_or_default(),
        ]
    }
}

fn robots_text(robots: &[RobotId]) -> String {
    if robots.len() > ROBOTS_NAMED_MAX {
        return counted(robots.len(), "robot");
    }
    robots.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// Formats a time as minutes and seconds, to a tenth: `1:03.9`.
fn clock(time: Span) -> String {
    let tenths = (time.as_millis_f64() / 100.0).round() as i64;
    format!("{}:{:02}.{}", tenths / 600, tenths / 10 % 60, tenths % 10)
}

fn escaped(text: &str) -> String {
    let text = downbeat_scripts::shown::shown(text).to_string();
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Quotes all cells, because they may contain commas and quotes. A spreadsheet would compute a cell that begins like a formula, so such a
/// cell begins with an apostrophe.
fn csv_line<'a>(cells: impl Iterator<Item = &'a str>) -> String {
    let cell = |cell: &str| {
        let guard = if cell.starts_with(['=', '+', '-', '@', '\t', '\r']) { "'" } else { "" };
        format!("\"{guard}{}\"", cell.replace('"', "\"\""))
    };
    let cells: Vec<_> = cells.map(cell).collect();
    cells.join(",") + "\r\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sheet(cue: &str, note: Option<&str>) -> CueSheet {
        let cue = SheetCue {
            number: "1.1".to_owned(),
            start: Span::from_millis(63_940),
            lasts: Span::from_millis(10_000),
            cue: cue.to_owned(),
            robots: vec!["r1".parse().unwrap(), "r2".parse().unwrap()],
            note: note.map(str::to_owned),
        };
        let duration = Span::from_millis(97_000);
        let act =
            SheetAct { act: "one".to_owned(), waits: "the operator".to_owned(), duration, cues: vec![cue] };
        CueSheet { scenario: "sky".to_owned(), acts: vec![act] }
    }

    #[test]
    fn csv_quotes_cells_and_disarms_formulas() {
        let csv = sheet("=SUM(1,\"2\")", Some("slowly")).csv();
        let lines: Vec<_> = csv.split("\r\n").collect();
        assert_eq!(lines[0], r#""act","number","time","lasts","cue","robots","note""#);
        assert_eq!(lines[1], r#""one","1.1","1:03.9","0:10.0","'=SUM(1,""2"")","r1, r2","slowly""#);
    }

    #[test]
    fn page_shows_names_as_text() {
        let page = sheet("<script>alert(1)</script>", None).html();
        assert!(page.contains("<h2>one: 1:37.0, waits for the operator</h2>"), "{page}");
        assert!(page.contains("<td>&lt;script&gt;alert(1)&lt;/script&gt;</td>"), "{page}");
        assert!(!page.contains("<script"), "{page}");
    }

    #[test]
    fn many_robots_are_counted() {
        let robots: Vec<RobotId> = (0..7).map(|i| format!("d{i}").parse().unwrap()).collect();
        assert_eq!(robots_text(&robots), "7 robots");
        assert_eq!(robots_text(&robots[..2]), "d0, d1");
    }
}
