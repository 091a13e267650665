"""What the tests of sessions share: to go to a step, to save, to see all views."""

import time

from accelsurf import io


def at(session, step):
    """The session, when it has made so many steps."""
    session.play(step).result(60)
    assert session.wait(60) and session.status.step == step
    return session


def labels_of(session, folder):
    """Bytes of the labels that it saves, and the file that repeats the run."""
    session.save(folder, ("labels", "run"), overwrite=True).result(60)
    return io.read_labels(
        folder / "surface_seg.nii.gz"
    ).array.tobytes(), folder / "surface_run.toml"


def views(session, seconds=20.0):
    """All views until it is paused and nothing new comes."""
    seen, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        view = session.next_view()
        if view is not None:
            seen.append(view)
        elif session.wait(0.0) and not session.has_unseen_state:
            view = session.next_view()
            if view is None:
                return seen
            seen.append(view)
        time.sleep(0.005)
    raise AssertionError("never paused")
