//! Tests acts that wait for a time of day in a dry run.

use stage::session::{Ran, Session};

#[test]
fn acts_start_at_awaited_local_times_and_show_date_on_another_day() {
    let session = Session::new();
    let act = |name: &str, time: &str| {
        format!(
            "  - {{act: {name}, wait: {{time: \"{time}\"}}, cues: [{{robots: arms, tracks: {{shoulder: [{{at: 0s, to: 0}}, {{at: 1s, to: 9}}]}}}}]}}\n"
        )
    };
    let acts = [act("late", "23:59:50"), act("early", "00:00:30")].concat();
    session.file("night.yaml", format!("scenario: night\nacts:\n{acts}"));
    let ran =
        Ran(session.command(&["dry-run", "night.yaml", "--verbose"]).env("TZ", "CET-1").output().unwrap());
    ran.says(0, &["23:59:50.000 ", "00:00:30.000 on 2 Jan 2026"]);
}
