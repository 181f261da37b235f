"""Reads processor time, memory and open files of processes from `/proc`."""

import os
import threading
from pathlib import Path

TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def memory_mb(pid, field="VmRSS"):
    """Resident memory (`VmRSS`) or its peak (`VmHWM`) in MB. `None` if the process has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return None
    return memory_of_status(status, field)


def memory_of_status(status, field):
    """The same from the text of `/proc/PID/status`, which has no memory after the process has ended."""
    for line in status.splitlines():
        if line.startswith(field + ":"):
            return int(line.split()[1]) / 1024
    return None


def processor_s(pid):
    """Seconds of processor time in user and kernel mode."""
    return processor_s_of_stat(Path(f"/proc/{pid}/stat").read_text())


def processor_s_of_stat(stat):
    """The same from the text of `/proc/PID/stat`. The name of the program may contain spaces and parentheses."""
    fields = stat.rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def open_files(pid):
    return len(os.listdir(f"/proc/{pid}/fd"))


class Watch(threading.Thread):
    """Samples the open files of processes until `end` is called or one of them ends; keeps the highest count of each."""

    def __init__(self, *pids, interval_s=0.1):
        super().__init__(daemon=True)
        self.pids, self.interval_s = pids, interval_s
        self.files_max = [0] * len(pids)
        self.ending = threading.Event()
        self.start()

    def run(self):
        while not self.ending.is_set():
            try:
                self.files_max = [max(most, open_files(pid)) for most, pid in zip(self.files_max, self.pids)]
            except OSError:
                return
            self.ending.wait(self.interval_s)

    def end(self):
        self.ending.set()
        self.join()
