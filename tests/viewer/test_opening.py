"""What can be opened, what is listed, what is asked first; without a window."""

import json
import threading
import time

import numpy as np
import pytest

from accelsurf import io
from accelsurf.errors import InputError, UsageError
from accelsurf.grid.geometry import Geometry
from accelsurf.image.volume import Volume
from accelsurf.run.memory import run_bytes
from accelsurf.settings.run_config import RunConfig
from accelsurf.viewer.actions.opening import Opening
from accelsurf.viewer.core import opening as core
from accelsurf.viewer.core.opening import MAX_ENTRIES, ServedFolder
from accelsurf.viewer.core.recent_files import MAX_RECENT, RecentFiles, recent_file
from tests.support.dicom_series import Series


def image(shape=(6, 7, 8), seed=0):
    return Volume.from_array(np.random.default_rng(seed).normal(100, 9, shape).astype(np.float32))


@pytest.fixture
def study(tmp_path):
    for number, columns in ((1, 9), (2, 12)):
        series = Series(
            rows=10, columns=columns, uid=f"1.2.3.{number}", changes={"SeriesNumber": number}
        )
        series.stacked(6).write(tmp_path / "study" / str(number))
    return tmp_path / "study"


# ------------------------------------------------------------------------------------------------------ recent files


def test_the_last_twelve_are_listed_the_newest_first(tmp_path):
    recent = RecentFiles(tmp_path / "state" / "recent.json")
    assert recent.entries() == []
    paths = [tmp_path / f"{n}.nii" for n in range(MAX_RECENT + 3)]
    paths[-1].touch()
    for path in (*paths, paths[5]):
        recent.add(path)
    found = recent.entries()
    assert [int(one.path.stem) for one in found] == [5, 14, 13, 12, 11, 10, 9, 8, 7, 6, 4, 3]
    assert [one.exists for one in found[:3]] == [False, True, False]
    assert (tmp_path / "state" / "recent.json").stat().st_mode & 0o077 == 0
    assert [path.name for path in (tmp_path / "state").iterdir()] == ["recent.json"]


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b'{"a": 1}', b"[1, null, [], {}]", b"\xff\xfe", b"[" * 5000, b'["a\\u0000b"]'],
)
def test_a_damaged_list_is_empty_and_is_written_anew(tmp_path, content):
    path = tmp_path / "recent.json"
    path.write_bytes(content)
    recent = RecentFiles(path)
    assert recent.entries() == []
    recent.add(tmp_path / "a.nii")
    assert json.loads(path.read_text()) == [str(tmp_path / "a.nii")]


def test_a_list_that_cannot_be_written_is_no_error(tmp_path):
    (tmp_path / "file").touch()
    recent = RecentFiles(tmp_path / "file" / "recent.json")
    recent.add(tmp_path / "a.nii")
    assert recent.entries() == []


def test_in_private_nothing_is_listed_or_stored(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    recent = RecentFiles(None)
    recent.add(tmp_path / "a.nii")
    assert recent.entries() == [] and not (tmp_path / "state").exists()
    assert recent_file() == tmp_path / "state" / "accelsurf" / "recent.json"


# -------------------------------------------------------------------------------------------------- a folder of a page


@pytest.fixture
def served(tmp_path):
    root = tmp_path / "root"
    (root / "scans").mkdir(parents=True)
    io.write(image(), root / "scans" / "a.nii.gz")
    for name in ("notes.txt", ".hidden.nii", "b.NRRD"):
        (root / name).write_text("x")
    (root / ".git").mkdir()
    (root / ".git" / "c.nii").touch()
    (tmp_path / "secret.nii").touch()
    (tmp_path / "secret").mkdir()
    (root / "out.nii").symlink_to(tmp_path / "secret.nii")
    (root / "out").symlink_to(tmp_path / "secret")
    (root / "in.nii").symlink_to(root / "b.NRRD")
    (root / "loop").symlink_to(root / "loop")
    (root / "cells.ome.zarr").mkdir()
    return ServedFolder(root)


@pytest.mark.program
def test_images_and_folders_are_listed_but_nothing_hidden_or_outside(served):
    entries, more = served.entries(served.root)
    assert [(one.name, one.is_image, one.is_folder) for one in entries] == [
        ("scans", False, True),
        ("b.NRRD", True, False),
        ("cells.ome.zarr", True, False),
        ("in.nii", True, False),
    ]
    assert more == 0
    assert [one.name for one in served.entries(served.root / "scans")[0]] == ["a.nii.gz"]


def test_a_list_has_an_end(tmp_path):
    for number in range(MAX_ENTRIES + 7):
        (tmp_path / f"{number}.nii").touch()
    entries, more = ServedFolder(tmp_path).entries(tmp_path)
    assert len(entries) == MAX_ENTRIES and more == 7


@pytest.mark.parametrize(
    "name",
    [
        "..",
        "../secret.nii",
        "scans/../../secret.nii",
        "/etc/passwd",
        "out.nii",
        "out",
        "out/x.nii",
        ".git/c.nii",
        "loop",
        ".hidden.nii",
        "a\x00b",
        "//etc/passwd",
        "~/x.nii",
        "\ud800",
        "scans/.././.git",
        "out/../../secret",
    ],
)
@pytest.mark.program
def test_what_is_not_in_the_folder_is_refused_alike(served, name):
    with pytest.raises(UsageError, match="is not in the folder root") as error:
        if name.startswith("~"):  # a name like others, in the folder
            assert served.resolve(name).parent.parent == served.root
            raise UsageError("is not in the folder root")
        served.resolve(name)
    assert str(served.root.parent) not in str(error.value).replace(name, "")


@pytest.mark.program
def test_paths_in_the_folder(served):
    for name in (
        "scans/a.nii.gz",
        "./scans/a.nii.gz",
        str(served.root / "scans" / "a.nii.gz"),
        "absent.nii",
        ".",
    ):
        assert served.resolve(name).is_relative_to(served.root)
    assert served.shown(served.root) == "" and served.shown(served.root / "scans") == "scans"


# --------------------------------------------------------------------------------------------------------- reading


def test_series_of_a_folder_are_choices(study):
    choices = core.choices_of(study, RunConfig())
    assert [dict(one.settings) for one in choices] == [{"series": "1"}, {"series": "2"}]
    assert choices[1].text.startswith(
        "2  CT phantom, 12 x 10 x 6 voxels of 0.75 x 0.5 x 2 mm, axial"
    )
    opened = core.read_image(study, RunConfig(**choices[1].settings))
    assert (
        opened.volume.geometry.size == (12, 10, 6)
        and opened.name == "study"
        and opened.config.series == "2"
    )
    assert core.choices_of(study, RunConfig(series="1")) == []
    assert core.choices_of(study / "1", RunConfig()) == []  # one alone
    assert core.choices_of(study / "1" / "000.dcm", RunConfig()) == []
    assert core.read_image(study / "2" / "000.dcm", RunConfig()).volume.geometry.size == (12, 10, 6)


def test_time_points_are_choices(tmp_path):
    import nibabel

    path = tmp_path / "cine.nii.gz"
    values = np.arange(3 * 4 * 5 * 3, dtype=np.float32).reshape(5, 4, 3, 3)
    stack = nibabel.Nifti1Image(values, np.eye(4))
    stack.header.set_xyzt_units("mm", "sec")
    nibabel.save(stack, path)
    choices = core.choices_of(path, RunConfig())
    assert [one.text for one in choices] == [f"time point {n} of 3" for n in (1, 2, 3)]
    opened = core.read_image(path, RunConfig(**choices[2].settings))
    assert (
        opened.volume.array.max() == values.max()
        and opened.config.time_index == 2
        and not opened.channels
    )
    assert core.choices_of(path, RunConfig(channels_from_time=True)) == []
    assert len(core.read_image(path, RunConfig(channels_from_time=True)).channels) == 2


def test_the_level_is_that_which_fits_and_the_settings_say_it(tmp_path, monkeypatch):
    path = tmp_path / "cells.ome.zarr"
    io.write(
        Volume(np.zeros((96, 96, 96), np.uint8), Geometry((96, 96, 96), (1.0, 1.0, 1.0))), path
    )
    assert core.read_image(path, RunConfig()).volume.geometry.shape == (96, 96, 96)
    monkeypatch.setattr(core, "allowed_bytes", lambda text, free: run_bytes(96**3, False) - 1)
    opened = core.read_image(path, RunConfig())
    assert opened.volume.geometry.shape == (48, 48, 48) and opened.config.level == 1
    assert opened.note.startswith("level 1 of 0 to 1 is read, the finest that fits")
    assert core.read_image(path, RunConfig(level=0)).config.level == 1  # 0 is what nobody asked for
    monkeypatch.undo()
    assert core.read_image(path, RunConfig(level=1)).config.level == 1


def test_options_that_a_format_lacks_are_left_out(tmp_path):
    io.write(image(), tmp_path / "a.mha")
    opened = core.read_image(
        tmp_path / "a.mha", RunConfig(series="3", level="auto", smoothness=0.5)
    )
    assert (
        opened.config.series is None
        and opened.config.level == 0
        and opened.config.smoothness == 0.5
    )


def test_what_belongs_to_one_image_is_left_behind():
    config = RunConfig(
        inside="ball:1,2,3,4",
        outside="point:9,9,9",
        smoothness=0.3,
        edit=[{"step": 3, "smoothness": 1.0}],
        roi="0,0,0,5,5,5",
        series="4",
        threads=2,
        flow="gradient",
    )
    assert config.energy == "seeded"
    assert core.for_another_image(config) == RunConfig(smoothness=0.3, threads=2, flow="gradient")


def test_a_phantom_is_that_of_the_command(tmp_path):
    from accelsurf import cli

    assert cli.execute(["synth", "ball_small", "-o", str(tmp_path)]) == 0
    opened = core.make_phantom("ball_small", RunConfig())
    assert np.array_equal(opened.volume.array, io.read(tmp_path / "ball_small.nii.gz").array)
    assert opened.source is None and opened.reference.array.sum() > 100
    assert set(core.phantom_texts()) >= {"ball_small", "vessel"}


# ---------------------------------------------------------------------------------------------------------- requests


class Shown:
    """What the opening needs of the actions: whether something is unsaved, and where to say something."""

    def __init__(self, unsaved=False, geometry=None):
        self.notes, self.message, self.compared = [], "", []
        self.is_unsaved = unsaved
        self.scene = self.session = self.status = self
        self.ready = False
        self.geometry = geometry

    def feature(self, kind):
        return self

    def note(self, line, seconds=8.0):
        self.notes.append(line)

    def compare(self, labels):
        self.compared.append(labels)


def finish(opening, seconds=30.0):
    end = time.monotonic() + seconds
    while opening.is_busy:
        assert time.monotonic() < end
        if (found := opening.fetch()) is not None:
            return found
        time.sleep(0.01)
    return None


@pytest.fixture
def opening(tmp_path):
    return Opening(
        RunConfig(smoothness=0.5, start="ball:1,2,3,2"), RecentFiles(tmp_path / "recent.json")
    )


def test_an_image_is_read_in_a_thread_and_then_listed(opening, tmp_path):
    io.write(image(), tmp_path / "a.nii")
    opening.request("open", str(tmp_path / "a.nii"))
    assert opening.is_busy and opening.message == "reading a.nii ..."
    opening.request("open_phantom", "ball")
    assert opening.failed and opening.message.startswith(
        "something else is being opened: reading a.nii"
    )
    opened = finish(opening)
    assert opened.config.start == ("ball:1,2,3,2",) and opened.name == "a" and opening.message == ""
    opening.show(Shown(), opened)
    assert opening.state()["recent"] == [{"name": "a.nii", "folder": str(tmp_path), "exists": True}]
    opening.request("open_recent", 0)
    assert finish(opening).config.start == ("center",)  # the start was that of the first image


def test_each_further_image_has_a_folder_of_its_own_for_results(opening, tmp_path):
    folders = [opening.results_of_next(tmp_path / "out", "scan") for _ in range(3)]
    assert [path.relative_to(tmp_path).as_posix() for path in folders] == [
        "out",
        "out/scan-2",
        "out/scan-3",
    ]
    assert opening.results_of_next(None, "scan") is None


def test_errors_are_one_line_and_nothing_is_returned(opening, tmp_path):
    (tmp_path / "broken.nii").write_bytes(b"x" * 400)
    for name in ("broken.nii", "absent.nii", "."):
        opening.request("open", str(tmp_path / name))
        assert finish(opening) is None and opening.failed
        assert opening.message and "\n" not in opening.message and len(opening.message) <= 300
    for request in (
        ("open_recent", 0),
        ("open_phantom", "none"),
        ("choose", 0),
        ("answer", "open"),
        ("open_reference", "a.nii"),
        ("list_folder", ""),
        ("open", ""),
        ("drop",),
        ("drop", "a", "b"),
        ("nothing",),
        (None,),
        ("open",),
    ):
        opening.request(*request)
        assert opening.failed and opening.message, request
        assert not opening.is_busy


def test_what_is_not_saved_is_asked_for(opening, tmp_path):
    io.write(image(), tmp_path / "a.nii")
    opening.actions = Shown(unsaved=True)
    opening.request("open", str(tmp_path / "a.nii"))
    state = opening.state()
    assert (
        state["question"] == "Open a.nii; what was done here and is not saved will be lost?"
        and not opening.is_busy
    )
    assert [name for name, _ in state["answers"]] == ["open", "cancel"]
    opening.request("answer", "reference")
    assert opening.failed and opening.state()["question"]
    opening.request("answer", "cancel")
    assert not opening.state()["question"] and not opening.is_busy
    opening.request("open", str(tmp_path / "a.nii"))
    opening.request("answer", "open")
    assert finish(opening).name == "a"
    opening.actions.is_unsaved = False
    opening.request("open", str(tmp_path / "a.nii"))
    assert finish(opening).name == "a"


def test_what_is_dropped_may_be_a_reference(opening, tmp_path):
    labels = image().with_array((image().array > 100).astype(np.uint8))
    io.write(labels, tmp_path / "labels.nii")
    io.write(Volume.from_array(np.ones((3, 3, 3), np.uint8)), tmp_path / "other.nii")
    opening.actions = Shown(geometry=labels.geometry)
    opening.request("drop", str(tmp_path / "labels.nii"))
    assert [name for name, _ in opening.state()["answers"]] == ["open", "reference", "cancel"]
    opening.request("answer", "reference")
    assert finish(opening) is None and not opening.failed
    assert np.array_equal(opening.actions.compared[0].array, labels.array)
    opening.request("open_reference", str(tmp_path / "other.nii"))
    assert finish(opening) is None
    assert (
        opening.failed
        and "not on the image's grid" in opening.message
        and len(opening.actions.compared) == 1
    )


def test_one_of_several_is_asked_for(opening, study):
    opening.request("open", str(study))
    assert finish(opening) is None and len(opening.state()["choices"]) == 2
    opening.request("choose", 2)
    assert opening.failed and len(opening.state()["choices"]) == 2
    opening.request("choose", 1)
    assert finish(opening).config.series == "2" and opening.state()["choices"] == []
    opening.request("open", str(study))
    finish(opening)
    opening.request("answer", "cancel")
    assert opening.state()["choices"] == []


BAD = [
    None,
    True,
    -1,
    10**9,
    1e308,
    float("nan"),
    "",
    "x" * 100_000,
    "../../etc/passwd",
    "/etc/passwd",
    "a\x00b",
    "\ud800",
    [],
    {},
    [[[]]],
    b"\xff",
    object(),
    "~root/.ssh",
]


def test_nothing_that_a_page_sends_raises_or_opens_what_is_outside(tmp_path):
    root = tmp_path / "root"
    root.mkdir()
    made = Opening(RunConfig(), RecentFiles(None), ServedFolder(root))
    assert "drop" not in made.names
    before = threading.active_count()
    for name in (*made.names, "drop", "_start", "fetch", "show", None, 7, [], {}):
        for bad in BAD:
            for values in ((), (bad,), (bad, bad), (bad,) * 7):
                made.request(name, *values)
                assert isinstance(made.message, str) and len(made.message) <= 300
                assert "root:" not in made.message
                assert finish(made) is None
    assert threading.active_count() <= before + 1
    json.dumps(made.state())


def test_a_page_goes_through_its_folder(tmp_path):
    root = tmp_path / "root"
    (root / "scans").mkdir(parents=True)
    io.write(image(), root / "scans" / "a.nii.gz")
    made = Opening(RunConfig(), RecentFiles(None), ServedFolder(root))
    assert made.state()["folders"] == [["scans", "scans"]] and made.state()["above"] is None
    made.request("list_folder", "scans")
    state = made.state()
    assert (
        state["images"] == [["a.nii.gz", "scans/a.nii.gz"]]
        and state["above"] == ""
        and state["folder"] == "scans"
    )
    made.request("list_folder", "..")
    assert made.failed and made.state()["folder"] == "scans"
    made.request("open", state["images"][0][1])
    assert finish(made).name == "a"
    for wrong in ("../root/scans/a.nii.gz", str(tmp_path), "absent.nii"):
        made.request("open", wrong)
        assert finish(made) is None and made.failed


def test_a_folder_that_is_an_image_can_be_opened_as_one(study):
    made = Opening(RunConfig(), RecentFiles(None), ServedFolder(study))
    assert made.state()["this_image"] == "."
    made.request("open", ".")
    assert finish(made) is None and len(made.state()["choices"]) == 2


def test_labels_on_another_grid_are_no_reference(tmp_path):
    io.write(Volume.from_array(np.ones((3, 3, 3), np.uint8)), tmp_path / "a.nii")
    with pytest.raises(InputError, match=r"a\.nii: the reference is not on the image's grid"):
        core.read_reference(tmp_path / "a.nii", image().geometry)
