"""What workers do in tests of the pool, where a process of its own can import it; a pool without processes."""

import os
import signal
import time
from pathlib import Path


def work(payload):
    """Do what the payload says: a pair of a word and a value."""
    word, value = payload
    if word == "double":
        return 2 * value
    if word == "pid":
        return os.getpid()
    if word == "pid later":
        time.sleep(value)
        return os.getpid()
    if word == "raise":
        raise ValueError(value)
    if word == "memory":
        raise MemoryError(value)
    if word == "unsendable":
        return lambda: value
    if word == "hang":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        time.sleep(600)
    if word == "mark":
        Path(value).touch()
        time.sleep(600)
    if word == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if word == "exit":
        os._exit(value)
    if word == "eat":
        filled = bytearray(os.urandom(1024)) * (value // 1024)
        time.sleep(600)
        return len(filled)
    raise AssertionError(word)


def sleep_first():
    """What a worker loads, slowly."""
    time.sleep(0.7)


def cannot_load():
    """What a worker loads, and cannot."""
    os._exit(3)


class InlinePool:
    """Runs jobs one after another in this process, as `LocalPool` would elsewhere; remembers which."""

    ran: list = []

    def __init__(self, function, jobs, **options):
        self.function, self.jobs, self.options = function, jobs, options
        self.waiting = []

    def submit(self, job):
        self.waiting.append(job)

    def events(self):
        from accelsurf.batch.pool import Ended, Failure, Started, run_job

        for job in self.waiting:
            if job.bytes > (self.options.get("bytes") or job.bytes):
                yield Ended(job.key, None, Failure("memory", "needs more"))
                continue
            yield Started(job.key)
            InlinePool.ran.append(job.key)
            yield Ended(job.key, *run_job(self.function, job.payload))

    def interrupt(self):
        raise AssertionError("nobody waits")

    def stop(self):
        return iter(())

    def close(self):
        self.waiting = []
