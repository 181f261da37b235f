//! Tests the limit on the number of acts that a dry run plays (`--acts`).

use stage::session::Session;

#[test]
fn dry_run_reports_that_it_reached_its_act_limit() {
    let session = Session::new();
    let act = |name: &str, more: &str| {
        format!(
            "  - {{act: {name}, {more}cues: [{{robots: arms, tracks: {{shoulder: [{{at: 0s, to: 0}}, {{at: 1s, to: 9}}, {{at: 2s, to: 0}}]}}}}]}}\n"
        )
    };
    session.file(
        "loop.yaml",
        format!(
            "scenario: loop\nacts:\n{}{}",
            act("one", "wait: {for: operator, timeout: 1m, otherwise: end}, "),
            act("two", "next: one, ")
        ),
    );
    let bound = "ended because the limit of 3 acts was reached; another act would have followed";
    session.run(&["dry-run", "loop.yaml", "--acts", "3"]).says(0, &[bound]);
    session.file("once.yaml", format!("scenario: once\nacts:\n{}{}", act("one", ""), act("two", "")));
    let ran = session.run(&["dry-run", "once.yaml", "--acts", "2"]);
    assert_eq!(
        (ran.code(), ran.text().contains("was reached; another act")),
        (0, false),
        "no other act would have followed: {}",
        ran.text()
    );
}
