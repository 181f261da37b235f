//! Tests pictures of dry runs: the picture of a five-minute show with ten robots stays readable, and its file stays small. The
//! environment variable `DOWNBEAT_PICTURE=show.svg` keeps the picture.

use std::fmt::Write as _;

use roxmltree::{Document, Node};

use stage::session::Session;

/// The devices of a robot. Each has an id, an interpolation, a minimum and a maximum value.
type Devices = [(&'static str, &'static str, i32, i32); 4];

const ARM: Devices = [
    ("pan", "linear", -180, 180),
    ("lift", "linear", -90, 90),
    ("elbow", "linear", -120, 120),
    ("gripper", "linear", 0, 100),
];
const LIGHT: Devices = [
    ("pan", "linear", -180, 180),
    ("tilt", "linear", -90, 90),
    ("dimmer", "linear", 0, 255),
    ("gobo", "hold", 0, 12),
];
const PARTS: [&str; 6] = ["intro", "verse", "bridge", "chorus", "solo", "finale"];
const VERBS: [&str; 5] =
    ["rises & turns", "waves to the audience", "blinks", "follows the singer <slowly>", "bows"];
/// Length of a part of the show, in seconds.
const PART: usize = 50;

fn init(kind: &str, devices: Devices) -> String {
    let device = |(id, interpolation, least, largest): (&str, &str, i32, i32)| {
        let range = format!("min_value: {least}, max_value: {largest}, granularity: 0.01, max_error: 0.5");
        format!(
            "  - id: {id}\n    name: {id}\n    interpolation: {interpolation}\n    script_queue: 4\n    available_control_types:\n      position: {{{range}}}\n      script: {{{range}, max_number_of_steps: 256, control_types: [position]}}\n"
        )
    };
    format!(
        "id: {kind}\napi_version: \"1\"\nreports: true\ninquiry: true\ndevices:\n{}",
        devices.map(device).concat()
    )
}

/// Returns the YAML track of a device: a hold, a wave or a ramp. `part` is the number of its cue among the cues of the robot.
fn track(robot: usize, part: usize, (id, interpolation, least, largest): (&str, &str, i32, i32)) -> String {
    let (middle, most) = ((least + largest) / 2, (largest - least) / (3 + part as i32 % 3));
    let length = [9, 42, 1, 33, 24][(robot * 3 + part) % 5];
    if interpolation == "hold" {
        let keyframe = |at: usize| format!("{{at: {at}s, to: {}}}", (at * 5 + robot) % 12);
        return format!("{id}: [{}]", (0..=length).step_by(4).map(keyframe).collect::<Vec<_>>().join(", "));
    }
    match (robot + part + id.len()) % 3 {
        0 => format!(
            "{id}: {{wave: {{amplitude: {most}, period: {}s, center: {middle}, for: {length}s}}}}",
            2 + robot % 4
        ),
        1 => format!(
            "{id}: [{{at: 0s, to: {middle}}}, {{at: {length}s, to: {}, ease: smooth}}]",
            middle + most
        ),
        _ => format!(
            "{id}: [{{at: 0s, to: {}}}, {{at: {length}s, to: {middle}, ease: smooth}}]",
            middle - most
        ),
    }
}

fn cue(robot: usize, part: usize) -> String {
    let (kind, devices) = if robot < 5 { ("arm", ARM) } else { ("light", LIGHT) };
    let name =
        format!("{} {}: {kind} {} {}", PARTS[part], part + 1, robot + 1, VERBS[(robot + part * 2) % 5]);
    let tracks: Vec<_> =
        devices.iter().skip((robot + part) % 2).map(|device| track(robot, part, *device)).collect();
    let at = part * PART + (robot * 7 + part * 3) % 8;
    format!(
        "  - {{cue: '{name}', at: {at}s, robots: {kind}-{}, tracks: {{{}}}}}\n",
        robot + 1,
        tracks.join(", ")
    )
}

/// Creates a show: ten robots with four devices each, sixty long cues, and one cue (`flick`) of 40 ms.
fn show() -> Session {
    let session = Session::new();
    session.file("arm10.yaml", init("arm", ARM)).file("light.yaml", init("light", LIGHT));
    let mut fleet = "robots:\n".to_owned();
    let mut scenario = "scenario: five minutes\nstart_tolerance: 1s\ncues:\n".to_owned();
    for robot in 0..10 {
        let (kind, file) = if robot < 5 { ("arm", "arm10") } else { ("light", "light") };
        let _written = writeln!(fleet, "  {kind}-{}: {{init: {file}.yaml, address: sim}}", robot + 1);
        (0..6).for_each(|part| scenario += &cue(robot, part));
    }
    let flick = "[{at: 0s, to: 0}, {at: 20ms, to: 100}, {at: 40ms, to: 0}]";
    let _written =
        writeln!(scenario, "  - {{cue: flick, at: 299s, robots: arm-1, tracks: {{gripper: {flick}}}}}");
    session.file("fleet.yaml", fleet).file("show.yaml", scenario);
    session
}

fn of_class<'a>(picture: &'a Document<'a>, class: &'a str) -> impl Iterator<Item = Node<'a, 'a>> {
    picture.descendants().filter(move |node| {
        node.attribute("class").is_some_and(|classes| classes.split(' ').any(|one| one == class))
    })
}

fn number(node: Node<'_, '_>, name: &str) -> f64 {
    node.attribute(name).unwrap().parse().unwrap()
}

#[test]
fn picture_of_five_minute_show_with_ten_robots_is_readable() {
    let session = show();
    session.run(&["dry-run", "show.yaml", "--picture", "show.svg"]).says(0, &["done"]);
    let svg = std::fs::read_to_string(session.path("show.svg")).unwrap();
    if let Some(path) = std::env::var_os("DOWNBEAT_PICTURE") {
        std::fs::write(path, &svg).unwrap();
    }
    assert!(svg.len() < 500_000, "{} bytes", svg.len());
    let picture = Document::parse(&svg).unwrap();
    let width = number(picture.root_element(), "width");
    assert!((2_000.0..2_400.0).contains(&width), "{width} pixels wide");
    assert_eq!(of_class(&picture, "head").count(), 10, "a header a robot");
    assert_eq!(of_class(&picture, "lane").count(), 40);
    assert_eq!(svg.matches(">2:30<").count(), 2, "a ruler above and one below");
    check_names(&picture, width);
    // A flick within one pixel spans the minimum to the maximum value, 22 pixels.
    let lane =
        picture.descendants().find(|node| node.text().is_some_and(|text| text.starts_with("arm-1, gripper")));
    let paths =
        lane.and_then(|title| title.parent()).unwrap().children().filter_map(|path| path.attribute("d"));
    assert!(
        paths.clone().count() == 2 && paths.clone().all(|path| path.contains("-22")),
        "{:?}",
        paths.collect::<Vec<_>>()
    );
}

/// Checks that 61 bars have titles, and that no name overlaps another cue of its row or extends beyond the picture.
#[track_caller]
fn check_names(picture: &Document<'_>, width: f64) {
    // Row, begin and end of each bar.
    let mut extents: Vec<(i64, f64, f64)> = Vec::new();
    let bars = of_class(picture, "cue").filter(|bar| bar.attribute("x").is_some());
    for bar in bars {
        let group = bar.parent().unwrap();
        assert!(group.children().any(|node| node.has_tag_name("title")));
        let (mut begin, mut end) = (number(bar, "x"), number(bar, "x") + number(bar, "width"));
        for name in group.children().filter(|node| node.has_tag_name("text")) {
            let (x, long) = (number(name, "x"), name.text().unwrap().chars().count() as f64 * 6.0);
            let before = name.attribute("text-anchor") == Some("end");
            (begin, end) = if before { (begin.min(x - long), end) } else { (begin, end.max(x + long)) };
        }
        assert!(begin > 0.0 && end < width, "{begin} to {end} of {width}");
        extents.push((number(bar, "y") as i64, begin, end));
    }
    assert_eq!(extents.len(), 61);
    extents.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    for pair in extents.windows(2).filter(|pair| pair[0].0 == pair[1].0) {
        assert!(pair[0].2 <= pair[1].1, "{pair:?}");
    }
}
