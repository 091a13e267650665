"""Which cases a person means: folders in four layouts, patterns, files, ids, shards."""

import pytest

from accelsurf.batch.case import Case, check_id, checked_ids
from accelsurf.batch.cases import Shard, read_cases, shard_of
from accelsurf.errors import InputError, UsageError


def made(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    return folder


def ids(given, layout="auto"):
    given = given if isinstance(given, list) else [given]
    return [case.id for case in read_cases([str(one) for one in given], layout)[0]]


def test_a_folder_of_images_in_the_order_of_their_names(tmp_path):
    made(
        tmp_path,
        "b.nii.gz",
        "a.nrrd",
        "c.TIF",
        ".hidden.nii",
        "notes.txt",
        "deeper/d.nii",
        "c.zraw",
    )
    cases, words = read_cases([str(tmp_path)])
    assert [case.id for case in cases] == ["a", "b", "c"] and words == "a folder of images"
    assert [case.image for case in cases] == [
        tmp_path / name for name in ("a.nrrd", "b.nii.gz", "c.TIF")
    ]
    assert all(case.image.is_absolute() and not case.settings for case in cases)


def test_an_empty_folder_is_refused(tmp_path):
    made(tmp_path, "notes.txt")
    with pytest.raises(InputError, match="no image in this folder") as error:
        read_cases([str(tmp_path)])
    assert "pattern" in error.value.hint


def test_nnunets_files_are_channels_of_their_case(tmp_path):
    made(
        tmp_path,
        "liver_1_0000.nii.gz",
        "liver_1_0001.nii.gz",
        "liver_2_0000.nii.gz",
        "liver_2_0001.nii.gz",
    )
    cases, words = read_cases([str(tmp_path)])
    assert (
        [case.id for case in cases] == ["liver_1", "liver_2"]
        and "nnU-Net" in words
        and "2 channels" in words
    )
    assert cases[1].image == tmp_path / "liver_2_0000.nii.gz"
    assert cases[1].settings == {"channel": (str(tmp_path / "liver_2_0001.nii.gz"),)}
    assert cases[1].channels == (tmp_path / "liver_2_0001.nii.gz",)


def test_a_missing_channel_is_named(tmp_path):
    made(tmp_path, "a_0000.nii", "a_0001.nii", "a_0002.nii", "b_0000.nii", "b_0002.nii")
    with pytest.raises(InputError, match="case b has no channel b_0001, other cases have 3"):
        read_cases([str(tmp_path)])


@pytest.mark.parametrize("beside", ["dataset.json", "../dataset.json"])
def test_numbered_files_of_one_name_are_channels_or_a_series(tmp_path, beside):
    folder = made(tmp_path / "images", "frame_0000.tif", "frame_0001.tif", "frame_0002.tif")
    with pytest.raises(UsageError, match="frame_0000.tif to frame_0002.tif") as error:
        ids(folder)
    assert "--layout nnunet" in error.value.hint
    assert ids(folder, "folder") == ["frame_0000", "frame_0001", "frame_0002"]
    assert ids(folder, "nnunet") == ["frame"]
    made(folder, beside)
    assert ids(folder) == ["frame"]


def test_numbers_that_do_not_begin_at_0_are_names(tmp_path):
    assert ids(made(tmp_path, "scan_0001.nii", "scan_0002.nii")) == ["scan_0001", "scan_0002"]
    with pytest.raises(InputError, match="case scan has no channel scan_0000"):
        ids(tmp_path, "nnunet")


def test_a_bids_tree_with_and_without_sessions(tmp_path):
    made(
        tmp_path,
        "sub-01/anat/sub-01_T1w.nii.gz",
        "sub-02/ses-b/anat/sub-02_ses-b_T2w.nii.gz",
        "sub-02/ses-a/anat/sub-02_ses-a_T1w.nii.gz",
        "sub-02/ses-a/anat/sub-02_ses-a_T1w.json",
        "sub-02/ses-a/anat/sub-02_ses-a_mod-T1w_defacemask.nii.gz",
        "sub-02/ses-a/func/sub-02_ses-a_bold.nii.gz",
        "derivatives/sub-01/anat/sub-01_dseg.nii.gz",
    )
    assert ids(tmp_path) == ["sub-01_T1w", "sub-02_ses-a_T1w", "sub-02_ses-b_T2w"]
    with pytest.raises(InputError, match="no image in this folder"):
        ids(tmp_path, "folder")


def test_a_pattern_and_a_list_of_files(tmp_path):
    made(tmp_path, "a/x_T1.nii", "b/y_T1.nii", "b/y_T2.nii", "b/y_T1.json")
    assert ids(f"{tmp_path}/**/*_T1.*") == ["x_T1", "y_T1"]
    assert ids([tmp_path / "b" / "y_T2.nii", tmp_path / "a" / "x_T1.nii"]) == ["y_T2", "x_T1"]
    with pytest.raises(InputError, match="no image has a name like this"):
        ids(f"{tmp_path}/*.mha")
    with pytest.raises(InputError, match="there is no such file"):
        ids([tmp_path / "b" / "y_T2.nii", tmp_path / "absent.nii"])
    with pytest.raises(UsageError, match="a folder among several"):
        ids([tmp_path / "b" / "y_T2.nii", tmp_path])


def test_the_path_tells_files_of_one_name_apart(tmp_path):
    made(tmp_path, "one/t/scan.nii", "two/t/scan.nii", "two/other.nii")
    assert ids(f"{tmp_path}/**/*.nii") == ["one_t_scan", "two_other", "two_t_scan"]


def test_a_layout_is_for_a_folder(tmp_path):
    made(tmp_path, "a.nii")
    with pytest.raises(UsageError, match="is no folder"):
        ids(tmp_path / "a.nii", "nnunet")
    with pytest.raises(UsageError, match="CASES is missing"):
        read_cases([])


# ---------------------------------------------------------------------------------------------------------------- ids


@pytest.mark.parametrize(
    "name",
    [
        "",
        "a/b",
        "..",
        "a\\b",
        ".a",
        "-a",
        "a ",
        "a.",
        "a:b",
        "\n",
        "\ud800",
        "x" * 161,
        "batch.csv",
        "Batch_1of2.csv",
    ],
)
def test_ids_that_are_no_names_of_folders(name, tmp_path):
    with pytest.raises(InputError, match="row 3: the id"):
        check_id(Case(name, tmp_path, place="row 3"))
    (case,) = checked_ids([Case(name, tmp_path, place="scan")])
    assert "scan: the id" in case.problem and case.id.isprintable() and case.id


def test_ids_that_are_safe(tmp_path):
    cases = [Case(name, tmp_path) for name in ("a b", "Ärzte", "sub-01_T1w", "1.2.3")]
    assert checked_ids(cases) == cases
    with pytest.raises(InputError):
        checked_ids([*cases, Case("ärzte", tmp_path)])


def test_an_id_that_is_given_twice_is_named_with_both_places(tmp_path):
    made(tmp_path, "A.nii", "b.nii", "a.nrrd")
    with pytest.raises(InputError, match=r"the id .* is given 2 times: .*A\.nii and .*a\.nrrd"):
        ids(tmp_path)


# ------------------------------------------------------------------------------------------------------------- shards


def test_shards_have_every_case_once():
    cases = list("abcdefg")
    parts = [Shard(number, 3).part_of(cases) for number in (1, 2, 3)]
    assert parts == [["a", "d", "g"], ["b", "e"], ["c", "f"]]


@pytest.mark.parametrize("text", ["0/3", "4/3", "1", "a/b", "1/0", "-1/3", "1/3/2"])
def test_shards_that_are_none(text):
    with pytest.raises(UsageError, match="expected I/N"):
        shard_of(text, {})


def slurm(**values):
    return {f"SLURM_ARRAY_TASK_{key}": str(value) for key, value in values.items()}


def test_an_array_of_slurm_is_a_shard_unless_one_is_given():
    environment = slurm(ID=12, COUNT=3, MIN=10)
    shard, line = shard_of(None, environment)
    assert shard == Shard(3, 3) and "SLURM_ARRAY_TASK_ID=12" in line
    assert shard_of("1/2", environment) == (Shard(1, 2), "")
    assert shard_of(None, slurm(ID=0, COUNT=3))[0] == Shard(1, 3)
    assert shard_of(None, slurm(ID=6, COUNT=4, MIN=0, STEP=2))[0] == Shard(4, 4)
    assert shard_of(None, slurm(ID=5, COUNT=1, MIN=5))[0] is None
    assert shard_of(None, {"SLURM_JOB_ID": "7"}) == (None, "")


@pytest.mark.parametrize(
    "values",
    [dict(ID=7, COUNT=3, MIN=1), dict(ID=2, COUNT=3, MIN=1, STEP=2), dict(ID="x", COUNT=2)],
)
def test_an_array_of_slurm_that_has_gaps_is_refused(values):
    with pytest.raises(UsageError) as error:
        shard_of(None, slurm(**values))
    assert "--shard" in error.value.hint
