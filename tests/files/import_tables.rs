//! `downbeat import csv`: tables as written by spreadsheets, loggers and cameras.

use stage::session::{Ran, Session};

/// Imports a file whose second column moves a device.
fn import(session: &Session, file: &str, options: &[&str]) -> Ran {
    session.run(&[&["import", "csv", file, "--time", "1", "--map", "r/a=2"], options].concat())
}

/// Imports a text, and checks the exit code and parts of the output.
#[track_caller]
fn check(text: impl AsRef<[u8]>, options: &[&str], code: i32, parts: &[&str]) {
    let session = Session::new();
    session.file("log.csv", text);
    import(&session, "log.csv", options).says(code, parts);
}

#[test]
fn german_spreadsheet_tables_are_read() {
    let rows = ["at: 500ms, to: 12.25", "at: 1s, to: -3.125", "commas in numbers are read as decimal commas"];
    let show = "\u{feff}Zeit [s];Hüfte [°];Kopf\r\n0,0;0,0;10\r\n0,5;12,25;11,5\r\n1,0;-3,125;1.000,5\r\n";
    check(show, &[], 0, &rows);
    check(show, &["--map", "r/b=Kopf"], 0, &["at: 1s, to: 1000.5"]);
    check("\"Zeit [s]\",\"x\"\r\n\"0\",\"0,0\"\r\n\"0,5\",\"1,5\"\r\n", &[], 0, &["at: 500ms, to: 1.5"]);
    check("sep=;\r\nt [s];x\r\n0;0.0\r\n1;1.5\r\n", &[], 0, &["at: 1s, to: 1.5"]);
    check("t [s],x\r0,0.0\r1,1.5\r", &[], 0, &["at: 1s, to: 1.5"]);
    let utf16: Vec<u8> = [0xfeff]
        .into_iter()
        .chain("t [s]\tx\r\n0\t0,5\r\n1\t1,5\r\n".encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    check(utf16, &[], 0, &["at: 1s, to: 1.5"]);
    check(b"Zeit [s];H\xfcfte\r\n0;1\r\n", &[], 2, &["DB0001", "not encoded in UTF-8", "`CSV UTF-8`"]);
}

#[test]
fn ambiguous_thousands_comma_requires_decimal_option() {
    let text = "t [s];x\n0;1,500\n1;2,250\n";
    check(text, &[], 1, &["DB0061", "log.csv:2:3", "`1,500`", "--decimal comma or --decimal point"]);
    check(text, &["--decimal", "comma"], 0, &["at: 0s, to: 1.5", "at: 1s, to: 2.25"]);
    check(text, &["--decimal", "point"], 0, &["at: 0s, to: 1500", "at: 1s, to: 2250"]);
    check(text, &["--decimal", "dot"], 2, &["point or comma"]);
    check("t [s];x\n0;0,5\n1;2.5\n", &["--decimal", "comma"], 1, &["DB0061", "log.csv:3:3", "`2.5`"]);
}

#[test]
fn spaces_separate_columns_of_logger_files() {
    check("t[s]   x [m]\n 0.0    1.5\n 0.25  -2\n", &[], 0, &["at: 0s, to: 1.5", "at: 250ms, to: -2"]);
    // Written like numpy's savetxt.
    let numpy =
        "# t[s] x\n0.000000000000000000e+00 1.500000000000000000e+00\n2.500000000000000000e-01 2.0e+00\n";
    check(numpy, &[], 0, &["at: 0s, to: 1.5", "at: 250ms, to: 2"]);
}

#[test]
fn title_lines_are_reported_and_can_be_skipped() {
    let text = "Trial 7; take 2\n\nt [s],x\n0,1\n1,2\n2,4\n";
    let parts = ["DB0060", "log.csv:1:1", "the lines from line 3 on", "--skip 2"];
    check(text, &[], 1, &parts);
    check(text, &["--skip", "2"], 0, &["at: 2s, to: 4"]);
    check(text, &["--skip", "20"], 1, &["the file is empty"]);
    let session = Session::new();
    session.file("a.bvh", "");
    session.run(&["import", "bvh", "a.bvh", "--skip", "2"]).says(2, &["--skip", "apply only to csv"]);
}

#[test]
fn frame_numbers_and_timecodes_are_converted_using_frame_rate() {
    let frames = "Frame,x\n1,0\n2,5\n121,6\n";
    check(frames, &[], 1, &["DB0062", "log.csv:1:1", "the frame rate is unknown", "--rate 25"]);
    check(frames, &["--rate", "120"], 0, &["at: 8.333333ms, to: 0", "at: 1.008333333s, to: 6", "--start 0s"]);
    check(frames, &["--rate", "120", "--start", "0s"], 0, &["at: 0s, to: 0", "at: 1s, to: 6"]);
    let timecodes = "TC,x\n00:00:01:00,0\n00:00:01:12,5\n00:01:00:00,6\n";
    check(timecodes, &[], 1, &["DB0062", "the frame rate of the timecodes is unknown", "--rate 25"]);
    check(timecodes, &["--rate", "25"], 0, &["at: 1480ms, to: 5", "at: 60s, to: 6"]);
    check(timecodes, &["--rate", "29.97"], 0, &["at: 1.4014s, to: 5", "at: 60060ms, to: 6"]);
    check(timecodes, &["--rate", "12"], 1, &["DB0061", "log.csv:3:1", "`00:00:01:12`"]);
    check("t [s],x\n0,1\n1,2\n", &["--rate", "25"], 0, &["--rate has no effect", "at: 1s, to: 2"]);
}

#[test]
fn dates_and_unix_times_are_relative_to_first_value() {
    let noted = "the times are dates, so they are counted from the first value";
    check(
        "when,x\n2026-11-23T20:30:00.250+01:00,1\n2026-11-23T19:30:01.000000005Z,2\n",
        &[],
        0,
        &["at: 0s, to: 1", "at: 750.000005ms, to: 2", noted],
    );
    check("when;x\n2026-11-23 19:30:00,250;1\n2026-11-23 19:30:01,250;2\n", &[], 0, &["at: 1s, to: 2"]);
    check(
        "stamp,x\n1795462200.123456789,1\n1795462200.123456999,2\n",
        &[],
        0,
        &["at: 0.21us, to: 2", "Unix times in s", noted],
    );
    check("stamp,x\n1795462200123,1\n1795462201123,2\n", &[], 0, &["at: 1s, to: 2", "Unix times in ms"]);
    check(
        "stamp [s],x\n1795462200,1\n1795462201,2\n",
        &["--start", "2s"],
        0,
        &["at: 2s, to: 1", "at: 3s, to: 2"],
    );
    check(
        "stamp [s],x\n1795462200,1\n1895462201,2\n",
        &[],
        1,
        &["DB0062", "log.csv:3:1", "a time from 1795462200"],
    );
    check(
        "stamp [s],x\n1795462201,1\n1795462200,2\n",
        &[],
        1,
        &["DB0062", "is earlier than the previous time"],
    );
    check("when,x\n2026-02-30T00:00:00Z,1\n", &[], 1, &["DB0062", "unknown format of the times"]);
    check("t [s],x\n-1,1\n", &[], 1, &["DB0062", "the time is -1 s"]);
}

#[test]
fn robots_in_one_recording_keep_their_time_offset() {
    let session = Session::new();
    session.file("a.csv", "t [s],x\n1795462200,1\n1795462201,2\n");
    session.file("b.csv", "t [s],x\n1795462200.5,3\n1795462201.5,4\n");
    let ran = session.run(&["import", "csv", "a.csv", "b.csv", "--time", "1", "--map", "x=2"]);
    ran.says(0, &["at: 0s, to: 1", "at: 500ms, to: 3", "at: 1500ms, to: 4"]);
    session.file("b.csv", "t [s],x\n1895462200.5,3\n");
    let ran = session.run(&["import", "csv", "a.csv", "b.csv", "--time", "1", "--map", "x=2"]);
    ran.says(1, &["DB0062", "lasts 100000000.5 s", "different days"]);
}
