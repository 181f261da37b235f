"""Writes the description of a robot, fleet files and scenarios."""

ROBOT = """id: robot
api_version: '1'
reports: true
devices:
  - id: d
    name: d
    available_control_types:
      position: {min_value: 0, max_value: 200, granularity: 1}
      script: {min_value: 0, max_value: 200, granularity: 1, max_number_of_steps: 200}
"""
"""A robot with one device, `d`."""
WAVE = "{d: [{at: 0s, to: 0}, {at: 500ms, to: 60}, {at: 1s, to: 20}, {at: 1500ms, to: 80}]}"
"""Tracks of a cue that moves the device of `ROBOT` for 1.5 s."""


def robot_with_id(robot):
    """The description of `ROBOT` with another id."""
    return ROBOT.replace("id: robot", f"id: {robot}", 1)


def fleet(addresses, init="robot.yaml", groups=None, head=""):
    """The text of a fleet file.

    `addresses` maps each robot to its address. `init` is the path of its description, with `{}` for the name of the robot.
    `groups` maps names to robots; by default the group `all` has each robot. `head` are the lines before the robots.
    """
    rows = "".join(f"  {robot}: {{init: {init.format(robot)}, address: \"{address}\"}}\n" for robot, address in addresses.items())
    groups = {"all": addresses} if groups is None else groups
    members = "".join(f"  {name}: [{', '.join(robots)}]\n" for name, robots in groups.items())
    return f"{head}robots:\n{rows}" + (f"groups:\n{members}" if members else "")


def scenario(name, cues, running, start_tolerance, **keys):
    """The text of a scenario with one act, whose cues are given as one line of YAML each."""
    head = {"scenario": name, "start_tolerance": start_tolerance, "stop_condition": f"{{running: {running}}}", **keys}
    lines = "".join(f"{key}: {value}\n" for key, value in head.items())
    return f"{lines}cues:\n" + "".join(f"  - {cue}\n" for cue in cues)
