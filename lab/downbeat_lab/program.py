"""Finds or builds the programs that an experiment runs: `downbeat`, and `zenohd` for Zenoh. Runs a command to its end."""

import argparse
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WITH_ZENOH = ("-p", "downbeat-robot", "--features", "downbeat/zenoh")
"""Arguments of Cargo that build `downbeat` with links over Zenoh."""
COMMAND_SHOWN = 80
"""Number of characters of a failed command that an error message shows."""


def arguments(description, zenoh=False):
    """A parser with the options that all experiments share."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--downbeat", metavar="PATH", help="program to run; by default Cargo builds it")
    if zenoh:
        parser.add_argument("--zenohd", metavar="PATH", help="router of Zenoh; by default that of PATH, or Cargo builds it")
    return parser


def build_folder():
    """The folder in which Cargo builds the workspace."""
    return Path(os.environ.get("CARGO_TARGET_DIR") or ROOT / "target").absolute()


def find_downbeat(given=None, zenoh=False, profile="release"):
    """The absolute path of `given`, or of the program that Cargo builds. Exits if `given` is not a program."""
    if given is not None:
        return existing(given)
    features = WITH_ZENOH if zenoh else ()
    subprocess.run(["cargo", "build", "--quiet", "--profile", profile, "-p", "downbeat", *features], cwd=ROOT, check=True)
    return existing(build_folder() / {"dev": "debug"}.get(profile, profile) / "downbeat")


def find_zenohd(given=None):
    """The absolute path of `given`, of the router in PATH, or of the router that Cargo builds in `target/zenohd`."""
    installed = ROOT / "target" / "zenohd"
    path = given or shutil.which("zenohd") or installed / "bin" / "zenohd"
    if given is None and not Path(path).exists():
        version = locked_version("zenoh", (ROOT / "Cargo.lock").read_text())
        subprocess.run(["cargo", "install", "zenohd", "--version", version, "--locked", "--quiet", "--root", installed,
                        "--no-default-features", "--features", "zenoh/transport_tcp,zenoh/transport_tls"],
                       env={**os.environ, "CARGO_TARGET_DIR": str(installed / "build")}, check=True)
    return existing(path)


def locked_version(package, lock):
    """The version of a package in the text of `Cargo.lock`."""
    return re.search(rf'^name = "{re.escape(package)}"\nversion = "(.*)"$', lock, re.MULTILINE)[1]


def existing(path):
    path = Path(path).absolute()
    if not os.access(path, os.X_OK) or path.is_dir():
        sys.exit(f"`{path}` is not a program")
    return str(path)


def run(*command, folder, timeout=None):
    """The standard output of a command. Exits with its output if its exit code is not 0."""
    ended = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=timeout)
    if ended.returncode != 0:
        sys.exit(f"{shown(command)}: exit code {ended.returncode}\n{ended.stdout}{ended.stderr}")
    return ended.stdout


def shown(command):
    """The beginning of a command for an error message, without the folder of the program."""
    return " ".join([Path(command[0]).name, *command[1:]])[:COMMAND_SHOWN]
