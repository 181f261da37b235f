//! Advice for keys of other programs (QLab, MoveIt, Skybrush, Blender and others) that have no equivalent in Downbeat.

/// Each entry is a map in which users write such keys, the keys, and the advice. In the advice, `{key}` and `{given}` stand for the key
/// and its value.
pub(super) const ADVICE: [(&str, &[&str], &str); 66] = [
    (
        "a cue",
        &["fade", "fade_in", "fade_out", "transition", "crossfade"],
        "write `ease: smooth` in each keyframe; `at` is the time at which its value is reached",
    ),
    (
        "a cue",
        &["delay", "wait", "pre_wait", "prewait", "pause"],
        "to begin later, write `at: {given}`, or `after: NAME + {given}`",
    ),
    (
        "a cue",
        &["post_wait", "postwait", "auto_continue", "auto_follow", "continue", "triggers"],
        "write `after: NAME + 1s` in the cue that follows this one",
    ),
    (
        "a cue",
        &["speed", "velocity", "max_velocity_scaling_factor", "time_scale"],
        "`duration` stretches a movement; `--speed` plays the whole show more slowly",
    ),
    (
        "a cue",
        &["acceleration", "max_acceleration_scaling_factor", "max_velocity"],
        "leave it out: the keyframes determine the speed, and `limits` in the fleet file restrict it",
    ),
    ("a cue", &["ease", "easing"], "write it in each keyframe: `{at: 1s, to: 45, ease: {given}}`"),
    (
        "a cue",
        &["color", "colour", "rgb", "led", "light", "lights"],
        "a light is a device: write its values in `tracks: {LAMP: [{at: 0s, to: [255, 0, 0]}]}`",
    ),
    (
        "a cue",
        &["takeoff", "take_off", "land", "goto", "position", "pose", "goal", "hover"],
        "use `shift: [0, 0, 1]` to move robots by metres, or `form: NAME` to move them to a formation; both need `over: 4s`",
    ),
    (
        "a cue",
        &["joint_names", "points", "trajectory", "planning_group", "named_target", "target"],
        "write `tracks: {DEVICE: [{at: 1s, to: 45}]}`; `downbeat import joint-trajectory` converts ROS trajectories",
    ),
    ("a cue", &["play"], "define a move that plays others under `moves`, and refer to it: `move: NAME`"),
    (
        "a cue",
        &["exclusive", "lock", "mutex", "resource"],
        "write `uses: NAME` in all cues that exclude each other, and `zones: [NAME]` at the top of the scenario",
    ),
    (
        "a cue",
        &["if", "condition", "while", "probability", "chance", "random"],
        "a cue has no condition; an act can have one: `wait: {sensor: ROBOT/SENSOR, below: 0.5}`",
    ),
    (
        "a cue",
        &["go", "trigger", "hotkey", "on", "midi", "osc"],
        "only an act can wait: write `wait: operator` next to the `cues` of an act",
    ),
    (
        "a cue",
        &["armed", "enabled", "disabled", "active", "muted", "mute", "skip"],
        "leave it out: every cue plays; to disable a cue, write `#` at the start of its lines",
    ),
    (
        "a cue",
        &["blend", "weight", "layer", "priority", "extrapolation", "strip"],
        "leave it out: a device follows one cue at a time",
    ),
    (
        "a cue",
        &["comment", "note", "notes", "description", "doc", "tags", "type"],
        "leave it out, or write a comment: `# {key}: {given}`",
    ),
    (
        "a cue",
        &["frame", "frames", "frame_start"],
        "write a time with its unit, as in `at: 1s`; at 25 frames per second, a frame lasts 40ms",
    ),
    ("a cue", &["cues"], "write the cues at the same level as this cue, or as a sequence under `sequences`"),
    (
        "a keyframe",
        &[
            "speed",
            "velocity",
            "velocities",
            "acceleration",
            "accelerations",
            "effort",
            "duration",
            "for",
            "fade",
            "in",
            "after",
        ],
        "leave it out: the value is reached at the time `at`, counted from the start of the cue",
    ),
    (
        "a keyframe",
        &["delay", "wait", "pause", "hold"],
        "leave it out, and repeat the value in a keyframe with a later `at`",
    ),
    (
        "a keyframe",
        &["by", "delta", "add", "relative", "offset", "change"],
        "write the target value, `to: 45`: keyframes are not relative to the previous one",
    ),
    (
        "a keyframe",
        &["from"],
        "leave it out: a keyframe starts at the value of the previous one; for the first one, add `{at: 0s, to: {given}}`",
    ),
    (
        "a keyframe",
        &["frame", "frames", "tick", "beat"],
        "write a time, as in `at: 1s` or `at: 2 beats`; at 25 frames per second, a frame lasts 40ms",
    ),
    (
        "a keyframe",
        &["handle_left", "handle_right", "handles", "tangent", "in_tangent", "out_tangent"],
        "leave it out: `ease: smooth` eases in and out, and a `spline` passes through points without stopping",
    ),
    (
        "a track",
        &["positions", "times_from_start", "values", "times"],
        "write `keyframes: [{at: 0s, to: 0}, {at: 1s, to: 20}]`",
    ),
    (
        "a wave",
        &["shape", "form", "type", "waveform"],
        "leave it out: a wave is always a sine; use a `formula` for other shapes",
    ),
    (
        "a wave",
        &["cycles", "times", "count", "repeat"],
        "write the total duration of the wave, as in `for: 8s`",
    ),
    ("a wave", &["bpm", "tempo"], "write `period: 1 beat`, with the `tempo` at the top of the scenario"),
    ("`along`", &["circle", "points"], "define the path under `paths`, and refer to it: `path: NAME`"),
    (
        "`form`",
        &["circle", "line", "grid", "v", "sphere", "text", "svg", "cloud", "points"],
        "define the formation under `formations`, and refer to it: `to: NAME`",
    ),
    (
        "the scenario",
        &["version", "author", "description", "date", "music", "audio", "doc", "comment"],
        "leave it out, or write a comment: `# {key}: {given}`",
    ),
    ("the scenario", &["duration", "length"], "leave it out: a show lasts as long as its cues"),
    (
        "the scenario",
        &["fps", "frame_rate", "frame_start", "frame_end", "timebase"],
        "leave it out: times have a unit, as in `1.5s`",
    ),
    (
        "the scenario",
        &["joint_names", "points", "trajectory", "joint_trajectory"],
        "use `downbeat import joint-trajectory` to convert a ROS trajectory to `cues:`",
    ),
    (
        "the scenario",
        &["robots", "groups", "drones", "swarm", "devices", "joints"],
        "write it in the fleet file, and list the robots in each cue",
    ),
    (
        "the scenario",
        &["repeat", "loop", "loops"],
        "write it in a cue; to repeat an act, write its own name under `next`, and another act under `otherwise`",
    ),
    ("an act", &["repeat", "loop"], "write it in the cues of the act"),
    (
        "an act",
        &["at", "after", "with", "before", "start", "previous", "parallel"],
        "acts follow each other in the order of the file, or as set with `next`",
    ),
    (
        "an act",
        &["trigger", "condition", "if", "when", "time", "delay"],
        "write what it waits for: `wait: operator`, `wait: {time: \"20:00\"}` or `wait: {sensor: ROBOT/SENSOR, below: 0.5}`",
    ),
    ("an act", &["timeout", "otherwise"], "write it under `wait`: `wait: {for: operator, {key}: {given}}`"),
    ("an act", &["length", "duration"], "leave it out: an act lasts as long as its cues"),
    (
        "an act",
        &["description", "doc", "comment", "note", "notes"],
        "leave it out, or write a comment: `# {key}: {given}`",
    ),
    ("`circle`", &["height", "z"], "write it next to the shape: `at: [0, 0, {given}]`"),
    (
        "`line`",
        &["from", "to", "start", "end"],
        "write its length, `length: 6`, and its centre next to the shape: `at: [0, 0, 1]`",
    ),
    (
        "the formation",
        &["square", "rectangle", "cube", "box", "matrix"],
        "write `grid: {spacing: 1}`; with `columns` and `rows`, additional robots form layers above",
    ),
    (
        "the formation",
        &["heart", "star", "ellipse", "spiral", "helix", "triangle", "polygon"],
        "write `svg: FILE.svg` with a `size`, or list the places as `points`",
    ),
    ("the formation", &["heading", "yaw", "angle", "orientation"], "write `rotate: {given}`, in degrees"),
    ("robot", &["position", "pose", "origin", "location"], "write its position: `body: {x: 1, y: 2}`"),
    ("robot", &["port"], "write it in the address: `address: tls://HOST:{given}`"),
    (
        "robot",
        &["max_speed", "max_velocity", "velocity"],
        "write it for each device: `limits: {DEVICE: {speed: 30}}`",
    ),
    (
        "robot",
        &["home", "unit", "units", "interpolation", "granularity", "tolerance", "default_value"],
        "write it for each device in the robot's description, the file that `init` refers to",
    ),
    ("robot", &["group", "groups"], "write it next to `robots`: `groups: {NAME: [ROBOT, ROBOT]}`"),
    ("robot", &["count", "number"], "write an entry for each robot, each with its own name and address"),
    (
        "robot",
        &["type", "color", "colour", "namespace", "enabled", "name", "description", "comment"],
        "leave it out, or write a comment: `# {key}: {given}`",
    ),
    ("a body", &["position", "pose", "origin"], "write its coordinates as separate keys: `x: 1, y: 2, z: 0`"),
    (
        "a body",
        &["height", "width", "length", "shape", "box", "sphere", "diameter"],
        "a body is a ball, `radius: 0.3`, or a box, `size: [0.4, 0.3, 0.2]`",
    ),
    (
        "the space",
        &["size", "bounds", "limits", "geofence", "floor", "ceiling", "walls", "box"],
        "write `keep_in: {x: [-4, 4], y: [-4, 4], z: [0, 3]}`",
    ),
    ("the space", &["obstacles", "no_fly", "forbidden"], "write `keep_out: {NAME: {x: [1, 2], y: [0, 1]}}`"),
    (
        "the fleet file",
        &["geofence", "fence", "bounds", "obstacles", "floor"],
        "write it under `space`, as in `space: {keep_in: {x: [-4, 4], y: [-4, 4]}}`, or as `keep_out`",
    ),
    (
        "the fleet file",
        &["frame", "origin", "version", "name", "description", "units"],
        "leave it out, or write a comment: `# {key}: {given}`",
    ),
    (
        "limits",
        &["min", "max", "range", "min_value", "max_value"],
        "write the range of values, `min_value` and `max_value`, in the description of the robot",
    ),
    ("limits", &["jerk"], "leave it out: only the `speed` and the `acceleration` have limits"),
    (
        "`simulate`",
        &["latency"],
        "write `delay: [0ms, {given}]` to delay messages, or `moves: {DEVICE: {latency: {given}}}` to delay the motion of a device",
    ),
    (
        "`simulate`",
        &["loss", "packet_loss", "interruptions"],
        "write it under `links` of a world file, for `downbeat dry-run --world`",
    ),
    ("`simulate`", &["noise"], "write it for each device: `moves: {DEVICE: {noise: {given}}}`"),
    ("a keyframe of several values", &["ease"], "leave it out: keyframes of several values have no easing"),
];
