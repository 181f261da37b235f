"""Tests of the library of the experiments, without the program `downbeat`: `python3 -m unittest discover lab`."""

import contextlib
import io
import math
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import agree
from downbeat_lab import fleet, ports, program, reports, sampling, shares
from downbeat_lab.processes import Processes, wait_with_usage
from downbeat_lab.tables import Table, figure

LAB = Path(__file__).resolve().parent
LISTENS = "print('r0 listens on tcp://127.0.0.1:7', flush=True); print('note'); print('r1 listens on tcp://127.0.0.1:8', flush=True); input()"


class Programs(unittest.TestCase):
    def test_a_given_program_is_found(self):
        self.assertEqual(program.find_downbeat(sys.executable), sys.executable)

    def test_a_folder_is_not_a_program(self):
        with self.assertRaisesRegex(SystemExit, "is not a program"):
            program.find_downbeat("/tmp")

    def test_the_folder_of_builds_follows_cargo(self):
        with mock.patch.dict(os.environ, {"CARGO_TARGET_DIR": "/elsewhere"}):
            self.assertEqual(program.build_folder(), Path("/elsewhere"))
        with mock.patch.dict(os.environ, {"CARGO_TARGET_DIR": ""}):
            self.assertEqual(program.build_folder(), program.ROOT / "target")

    def test_the_version_of_a_package_is_that_of_the_lock_file(self):
        lock = '[[package]]\nname = "zenoh-util"\nversion = "1.0.0"\n\n[[package]]\nname = "zenoh"\nversion = "1.6.2"\n'
        self.assertEqual(program.locked_version("zenoh", lock), "1.6.2")

    def test_a_command_that_fails_ends_the_experiment_with_its_output(self):
        with self.assertRaisesRegex(SystemExit, "(?s)exit code 3.*the reason"):
            program.run(sys.executable, "-c", "import sys; print('the reason'); sys.exit(3)", folder="/")


class Addresses(unittest.TestCase):
    def test_free_ports_differ_and_are_free(self):
        found = ports.free_ports(5)
        self.assertEqual(len(set(found)), 5)
        with socket.socket() as bound:
            bound.bind((ports.loopback(300), found[0]))

    def test_each_robot_has_an_address_of_its_own(self):
        self.assertEqual([ports.loopback(0), ports.loopback(249), ports.loopback(250), ports.loopback(3, network=1)],
                         ["127.0.1.1", "127.0.1.250", "127.0.2.1", "127.1.1.4"])
        self.assertEqual(len({ports.loopback(index) for index in range(ports.LOOPBACK_MAX)}), ports.LOOPBACK_MAX)

    def test_an_index_without_an_address_is_an_error(self):
        for index in (-1, ports.LOOPBACK_MAX):
            self.assertRaises(ValueError, ports.loopback, index)

    def test_waiting_for_a_server_ends_when_it_listens_or_dies(self):
        with socket.create_server(("127.0.0.1", 0)) as server:
            port = server.getsockname()[1]
            self.assertTrue(ports.wait_until_open(port, lambda: False))
        self.assertFalse(ports.wait_until_open(port, lambda: False))


class Fleets(unittest.TestCase):
    def test_a_fleet_names_each_robot_and_the_group_of_all(self):
        text = fleet.fleet({"a": "sim", "b": "tcp://127.0.0.1:1"}, head="identity: me.pem\n")
        self.assertEqual(text, 'identity: me.pem\nrobots:\n  a: {init: robot.yaml, address: "sim"}\n'
                               '  b: {init: robot.yaml, address: "tcp://127.0.0.1:1"}\ngroups:\n  all: [a, b]\n')

    def test_a_fleet_can_have_descriptions_per_robot_and_no_groups(self):
        text = fleet.fleet({"a": "sim"}, init="robots/{}.yaml", groups={})
        self.assertEqual(text, 'robots:\n  a: {init: robots/a.yaml, address: "sim"}\n')

    def test_a_description_gets_its_id_and_keeps_that_of_the_device(self):
        text = fleet.robot_with_id("r7")
        self.assertTrue(text.startswith("id: r7\n"))
        self.assertIn("- id: d\n", text)

    def test_a_scenario_has_its_keys_before_its_cues(self):
        text = fleet.scenario("s", ["{at: 0s}", "{at: 1s}"], running="5s", start_tolerance="2s", on_failure="without")
        self.assertEqual(text, "scenario: s\nstart_tolerance: 2s\nstop_condition: {running: 5s}\non_failure: without\n"
                               "cues:\n  - {at: 0s}\n  - {at: 1s}\n")


class ProcessesEnd(unittest.TestCase):
    def test_all_processes_end_after_an_error_also_suspended_ones(self):
        with self.assertRaises(KeyError), Processes() as processes:
            sleeping = [processes.start("sleep", "60") for _ in range(2)]
            sleeping[0].send_signal(signal.SIGSTOP)
            raise KeyError
        self.assertEqual([process.returncode for process in sleeping], [-signal.SIGKILL] * 2)

    def test_each_robot_is_awaited(self):
        with Processes() as processes:
            _, lines = processes.start_listening(sys.executable, "-c", LISTENS, robots=2, stdin=subprocess.PIPE)
        self.assertEqual(lines, ["r0 listens on tcp://127.0.0.1:7", "r1 listens on tcp://127.0.0.1:8"])

    def test_robots_that_do_not_start_end_the_experiment_with_their_errors(self):
        with tempfile.TemporaryDirectory() as folder, Processes() as processes:
            with self.assertRaisesRegex(SystemExit, "ended after 0 of 1 robots: no room"):
                processes.start_listening("sh", "-c", "echo no room >&2", robots=1, errors=Path(folder) / "errors")

    def test_the_usage_of_a_process_is_known_with_its_exit_code(self):
        with Processes() as processes:
            process = processes.start("sh", "-c", "exit 4")
            usage = wait_with_usage(process)
        self.assertEqual(process.returncode, 4)
        self.assertGreater(usage.ru_maxrss, 0)


class Samples(unittest.TestCase):
    def test_memory_is_in_megabytes(self):
        status = "Name:\tdownbeat\nVmHWM:\t    4096 kB\nVmRSS:\t    1536 kB\n"
        self.assertEqual(sampling.memory_of_status(status, "VmRSS"), 1.5)
        self.assertEqual(sampling.memory_of_status(status, "VmHWM"), 4.0)

    def test_a_process_that_has_ended_has_no_memory(self):
        process = subprocess.Popen(["true"])
        process.wait()
        self.assertIsNone(sampling.memory_mb(process.pid))

    def test_processor_time_is_user_and_kernel_time(self):
        stat = "7 (odd) name) S 1 " + " ".join(["0"] * 9) + f" {2 * sampling.TICKS_PER_S} {sampling.TICKS_PER_S} 99 99 20"
        self.assertEqual(sampling.processor_s_of_stat(stat), 3.0)
        self.assertGreater(sampling.processor_s(os.getpid()), 0.0)

    def test_a_watch_keeps_the_highest_count_of_files(self):
        watch = sampling.Watch(os.getpid(), interval_s=0.001)
        with contextlib.ExitStack() as files:
            for _ in range(20):
                files.enter_context(open(os.devnull))
            while watch.files_max[0] < 20:
                pass
        watch.end()
        self.assertGreaterEqual(watch.files_max[0], 20)


class Reports(unittest.TestCase):
    def test_instants_are_seconds_since_1970(self):
        self.assertEqual(reports.instant("1970-01-01T00:01:00Z"), 60.0)
        self.assertAlmostEqual(reports.instant("2026-11-23T11:58:16.329123456Z"), 1795435096.329123, places=5)

    def test_a_session_is_named_by_its_instant(self):
        self.assertAlmostEqual(reports.session_instant("wave@my-host-20261123T115816329"), 1795435096.329, places=5)

    def test_an_outcome_with_values_is_its_kind(self):
        self.assertEqual(reports.outcome({"outcome": "done"}), "done")
        self.assertEqual(reports.outcome({"outcome": {"done_without": ["a"]}}), "done_without")
        self.assertEqual(reports.outcome({}), "no report")

    def test_failures_can_be_those_of_one_robot(self):
        report = {"failures": [{"robot": "a", "text": "late"}, {"robot": "b", "text": "lost"}]}
        self.assertEqual(reports.failures(report), ["late", "lost"])
        self.assertEqual(reports.failures(report, "b"), ["lost"])

    def test_only_the_last_line_of_a_log_may_be_incomplete(self):
        text = '{"motion":"set","step":0}\n{"motion":"ramp"}\n{"mot'
        self.assertEqual(reports.values_set(reports.log_entries(text)), [{"motion": "set", "step": 0}])
        self.assertRaises(ValueError, reports.log_entries, '{"mot\n{"motion":"set"}\n')
        self.assertEqual(reports.log_entries(""), [])


class Shares(unittest.TestCase):
    def test_intervals_are_those_of_wilson(self):
        # 41 of 100, by Wilson's formula (1927).
        low, high = shares.wilson(41, 100)
        self.assertAlmostEqual(low, 0.3187, places=4)
        self.assertAlmostEqual(high, 0.5080, places=4)

    def test_no_successes_have_an_interval_from_zero(self):
        low, high = shares.wilson(0, 100)
        self.assertAlmostEqual(low, 0.0)
        self.assertAlmostEqual(high, 0.0370, places=4)

    def test_the_z_is_that_of_the_pooled_share(self):
        # docs/rehearse.md: 41 of 100 missions and 481 of 1000 dry runs.
        self.assertAlmostEqual(shares.z_of_two(41, 100, 481, 1000), -1.36, places=2)
        self.assertEqual(shares.z_of_two(0, 4, 0, 20), 0.0)

    def test_shares_differ_beyond_95_percent_and_if_z_is_not_a_number(self):
        self.assertEqual([shares.differ(z) for z in (0.0, -1.95, 1.97, math.nan)], [False, False, True, True])

    def test_linear_growth_has_the_exponent_1(self):
        self.assertAlmostEqual(shares.exponent(2.0, 20.0, 1000, 10000), 1.0)
        self.assertAlmostEqual(shares.exponent(2.0, 200.0, 1000, 10000), 2.0)


class Tables(unittest.TestCase):
    def test_figures_have_three_digits(self):
        self.assertEqual([figure(value) for value in (123.456, 12.345, 1.2345, -12.345, 7, "tcp")], ["123", "12.3", "1.23", "-12.3", "7", "tcp"])

    def test_headings_come_once_and_columns_are_aligned(self):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            table = Table("link", "a long heading", "s", widths=[6, 2, 5], left=1)
            table.row("tcp", 1, 2.0)
            table.row("tls", 10, 20.0)
        self.assertEqual(printed.getvalue(), "link    a long heading      s\n"
                                             "tcp                  1   2.00\n"
                                             "tls                 10   20.0\n")


class FaultsOfAgree(unittest.TestCase):
    def test_a_seed_draws_the_same_faults_for_processes_and_dry_runs(self):
        for mission in range(50):
            drawn = [agree.Faults(random.Random(f"0/{mission}")) for _ in range(2)]
            self.assertEqual(drawn[0].signals(), drawn[1].signals())
            self.assertEqual(len(drawn[0].signals()), 2 * ("stalls" in drawn[0].incidents()) + ("dies" in drawn[0].incidents()))

    def test_no_faults_without_a_generator(self):
        self.assertEqual((agree.Faults().signals(), agree.Faults().incidents(), str(agree.Faults())), ([], "", "no fault"))

    def test_an_end_depends_on_the_robots_that_started(self):
        self.assertEqual([agree.end("failed", started) for started in ("none", "some", "all")],
                         ["none started", "some started, others not", "all started, then failed"])


class Experiments(unittest.TestCase):
    def test_the_readme_names_each_experiment_and_no_other_file(self):
        listed = {line.split("`")[1] for line in (LAB / "README.md").read_text().splitlines() if line.startswith("| `")}
        programs = {path.name for path in LAB.iterdir() if path.is_file() and os.access(path, os.X_OK)}
        self.assertEqual(listed, programs)

    def test_each_experiment_prints_its_options(self):
        for experiment in LAB.glob("*.py"):
            if os.access(experiment, os.X_OK):
                with self.subTest(experiment.name):
                    help_text = program.run(str(experiment), "--help", folder="/")
                    self.assertIn("--downbeat", help_text)
                    self.assertIn("exits 1", help_text.lower())


if __name__ == "__main__":
    unittest.main()
