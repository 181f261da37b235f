"""Writes variants of `together.yaml` and its fleet in which each robot is told earlier, by the latency that `motion.py` has measured:
`compensate.py LATENCIES --fleet FILE --cues FILE`."""

import argparse
import json
import pathlib
import re

HERE = pathlib.Path(__file__).parent


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("latencies", type=pathlib.Path, help="JSON: milliseconds by robot")
    arguments.add_argument("--fleet", type=pathlib.Path, required=True, help="with a key `latency` for each robot")
    arguments.add_argument("--cues", type=pathlib.Path, required=True, help="with cues that begin earlier")
    given = arguments.parse_args()
    latencies = json.loads(given.latencies.read_text())

    fleet = (HERE / "together.fleet.yaml").read_text()
    scenario = (HERE / "together.yaml").read_text()
    for robot, latency in latencies.items():
        fleet = fleet.replace(f"  {robot}: {{", f"  {robot}: {{latency: {latency}ms, ")

    def earlier(cue: re.Match) -> str:
        return f"at: {1000 * int(cue[1]) - latencies[cue[2]]:.1f}ms, robots: {cue[2]},"

    given.fleet.write_text(fleet)
    given.cues.write_text(re.sub(r"at: (\d+)s, robots: (\S+),", earlier, scenario))


if __name__ == "__main__":
    main()
