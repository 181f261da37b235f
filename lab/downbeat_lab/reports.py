"""Reads the output of `downbeat`: reports, names of sessions, logs of robots."""

import datetime
import json


def instant(text):
    """Seconds since 1970 of an instant in RFC 3339, UTC, to the microsecond."""
    at = datetime.datetime.strptime(text[:19], "%Y-%m-%dT%H:%M:%S").replace(tzinfo=datetime.timezone.utc)
    return at.timestamp() + float("0" + text[19:-1])


def session_instant(session):
    """Seconds since 1970 at which a mission got its name, which ends with this instant, as in `wave@host-20261123T115816329`."""
    at = datetime.datetime.strptime(session.rsplit("-", 1)[1], "%Y%m%dT%H%M%S%f")
    return at.replace(tzinfo=datetime.timezone.utc).timestamp()


def outcome(report):
    """The kind of a report's outcome, without its values."""
    value = report.get("outcome", "no report")
    return value if isinstance(value, str) else next(iter(value))


def failures(report, robot=None):
    """The failures of a report as text, or only those of one robot."""
    return [failure["text"] for failure in report.get("failures", []) if robot in (None, failure["robot"])]


def log_entries(text):
    """The entries of a robot's log. The last line may be incomplete if its process was killed."""
    lines = text.splitlines()
    entries = [json.loads(line) for line in lines[:-1]]
    try:
        return entries + [json.loads(line) for line in lines[-1:]]
    except json.JSONDecodeError:
        return entries


def values_set(entries):
    """The entries of a log that set a value of a device."""
    return [entry for entry in entries if entry.get("motion") == "set"]
