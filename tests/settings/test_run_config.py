"""RunConfig: one validated object, TOML in and out without loss, errors that name the key."""

import json

import pytest
from pydantic import ValidationError

from accelsurf.errors import UsageError
from accelsurf.settings.catalogue import help_of
from accelsurf.settings.messages import expected
from accelsurf.settings.run_config import RunConfig

ODD = RunConfig(
    extension="fast-marching",
    preset="mr-white-matter",
    energy="0.5*geodesic:scale=1 + threshold:-1e-3,20",
    flow="flowable-mass:k=2.25,t0=0.5,lam=1e-17,rho=3,gravity=1.5,noise_length=3,noise_time=9",
    start=("ball:-1.5,2,3,4", 'label:a "quoted"\\ name\x7f é\n.nii.gz'),
    mask="mask.nii",
    roi="0,0,0,9,9,9vox",
    foreground=("ball:1,2,3,4",),
    background=("label:b.nii",),
    channel=("second.nii",),
    answer=2,
    max_volume=1e5,
    smoothness=0.1 + 0.2,
    balance=1.25,
    presmooth=1e-7,
    closing=2.5,
    clip=",250",
    edge_scale=0.7,
    edge_contrast=0.3,
    balloon=-0.2,
    diffusion=1 / 3,
    noise=0.1,
    friction=2.5,
    restart="off",
    cfl=0.9,
    max_steps=7,
    tolerance=0.3,
    levels=2,
    percentile=70,
    epsilon=0.75,
    half_width=6,
    mesh="stl,vtp",
    mesh_space="ras",
    mesh_smooth=2.0,
    mesh_faces=20000,
    mesh_error=0.5,
    save_sdf=True,
    format="mha",
    seed=2**40,
    reproducible=True,
    threads=2,
    edit=[
        "step=3 smoothness=0.25 energy='chan-vese + 0.1*area'",
        {"step": 1, "flow": "momentum", "cfl": 1 / 3},
    ],
    inside=("point:1,2,3", 'stroke:"a" b.csv'),
    outside=("ball:4,5,6,7vox",),
    box="1,2,3,7,8,9",
    size="2.5cm3",
    keep_state="yes",
    checkpoint="2.5min",
    level=2,
    channel_index=1,
    time_index=3,
    channels_from_time=True,
    series="1.2.3",
    spacing="0.2,0.2,1um",
    name=["2=liver"],
    color=["2=#102030"],
    label_table="names.csv",
    also="seg.nrrd,rtstruct",
    layout="bids",
    label_group="cells",
    window="-600,1500",
    stop_at_rest=True,
    end="present",
    refine=[
        "inside=point:1,2,3 inside='stroke:a b.csv' near=2.5 object=3",
        {"outside": ["ball:1,2,3,4"]},
        {"new": 4, "inside": "ball:1,2,3,4", "size": "4ml"},
        {"merge": [3, 4]},
        "split=point:1,2,3 new=7",
        "remove=7",
    ],
)


#: What cannot be given beside a start, levels and edits.
SEVERAL = RunConfig(objects='seeds "a".csv@2,5-9')
GIVEN = RunConfig(labels='almost "right".nii.gz@3')
CONFIGS = {
    "defaults": RunConfig(),
    "all changed": ODD,
    "several objects": SEVERAL,
    "given labels": GIVEN,
}


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
def test_toml_round_trip_is_exact(config, tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(config.to_toml(), encoding="utf-8")
    assert RunConfig.from_toml(path) == config


def test_odd_config_changes_every_field():
    # Otherwise the round trip above could lose a field without anyone noticing.
    same = [
        name for name in RunConfig.model_fields if getattr(ODD, name) == getattr(RunConfig(), name)
    ]
    assert same == ["objects", "labels"]  # which do not go with the others
    assert SEVERAL.objects != RunConfig().objects and GIVEN.labels != RunConfig().labels


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("cfl", 3, "greater than 0 and at most 1"),
        ("cfl", 0, "greater than 0"),
        ("smoothness", True, "a number"),
        ("smoothness", float("nan"), "a number"),
        ("balance", float("inf"), "a number"),
        ("flow", 3, "a text"),
        ("smoothness", -0.1, "at least 0"),
        ("smoothness", "rough", "rough was given"),
        ("presmooth", -1, "at least 0"),
        ("balance", 0, "greater than 0"),
        ("diffusion", -1, "at least 0, auto or free"),
        ("friction", 0, "or t"),
        ("friction", "x", "or t"),
        ("restart", "never", "auto or off"),
        ("max_volume", 0, "greater than 0"),
        ("mask", 5, "a text"),
        ("start", (), "one text"),
        ("start", 5, "one text"),
        ("max_steps", -1, "a whole number at least 0"),
        ("max_steps", 2.5, "a whole number"),
        ("percentile", 101, "at most 100"),
        ("tolerance", 0, "greater than 0"),
        ("half_width", 2, "at least 3 and at most 32 or auto"),
        ("noise", -0.1, "at least 0"),
        ("edge_scale", 0, "greater than 0, or auto"),
        ("edge_contrast", 0, "greater than 0, or auto"),
        ("balloon", "up", "a number"),
        ("reproducible", "maybe", "true or false"),
        ("epsilon", 3, "at most 2.5"),
        ("mesh", "ply,wrl", "ply, stl, obj, vtp, glb, csv or auto"),
        ("mesh", "", "ply, stl, obj, vtp"),
        ("mesh_space", "xyz", "lps or ras"),
        ("save_sdf", "maybe", "true or false"),
        ("format", "jpg", "nii.gz, nii, nrrd, mha, mhd, ome.zarr, png, tif or npy"),
        ("seed", -1, "at least 0"),
        ("threads", 0, "at least 1"),
    ],
)
def test_bad_value_is_one_clear_line(key, value, words):
    with pytest.raises(UsageError) as caught:
        RunConfig(**{key: value})
    message = str(caught.value)
    assert (
        message.startswith(f"{key}: ") and " was given, expected " in message and words in message
    )
    assert "\n" not in message
    # Before the help there may be a name that was meant.
    assert caught.value.hint.endswith(" ".join(help_of(key).split()))


@pytest.mark.parametrize(
    ("flow", "words"),
    [
        ("constant-density:k=0", "at least 0.1"),
        ("constant-density:lam=inf", "a number above 0"),
        ("constant-density:rho=-1", "a number above 0"),
        ("constant-density:rho=1e13", "a number of size 1e-18 to 1e"),
        ("flowable-mass:gravity=-1", "at least 0"),
        ("constant-density:noise_length=0", "above 0 or auto"),
        ("constant-density:noise_time=0", "above 0 or auto"),
        ("constant-density:t0=-1", "at least 0 or auto"),
        ("constant-density:k=1,t0=0", "t0 greater than 0 with k = 1"),
        ("constant-density:t0=0,k=0.5", "t0 greater than 0 with k = 0.5"),
        ("constant-density:gravity=1", "one of k, t0, lam, rho"),
        ("constant-density:k=2,k=2", "k of constant-density once"),
        ("constant-density:", "values after the colon"),
        ("sobolev:length=0", "above 0 or auto"),
        ("momentum:blend=1", "a blend below 1"),
        ("auto:k=3", "it has no settings"),
        ("sobolov", "gradient, sobolev or momentum"),
        ("gradent", "gradient"),
        ("Constant_Density", "constant-density"),
    ],
)
def test_bad_flow_is_one_clear_line(flow, words):
    with pytest.raises(UsageError) as caught:
        RunConfig(flow=flow)
    message = str(caught.value)
    assert message.startswith(f"flow: {flow} was given, expected ") and words in message
    assert "\n" not in message and "as in 'constant-density:rho=2'" in caught.value.hint


def test_text_values_are_read_as_the_command_line_gives_them():
    config = RunConfig(
        cfl="0.25",
        max_steps="12",
        friction="0.5",
        diffusion="2",
        mesh="PLY, stl,ply",
        start="center",
    )
    assert (config.cfl, config.max_steps, config.friction, config.diffusion) == (0.25, 12, 0.5, 2.0)
    assert config.mesh == ("ply", "stl") and config.start == ("center",)


@pytest.mark.parametrize(
    ("key", "near"), [("smothness", "smoothness"), ("max-steps", "max_steps"), ("Flow", "flow")]
)
def test_unknown_key_names_the_nearest(key, near, tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(f'"{key}" = 1\n')
    with pytest.raises(UsageError, match="no such setting") as caught:
        RunConfig.from_toml(path)
    assert f"did you mean {near}?" in caught.value.hint


@pytest.mark.parametrize(
    ("key", "value", "near"),
    [
        ("levels", "atuo", "auto"),
        ("mesh", "ply,slt", "stl"),
        ("mesh", ["ply", "ojb"], "obj"),
        ("energy", "chan-vse + area", "chan-vese"),
        ("energy", "local-region:r=8", "R"),
        ("energy", "likelihood:update=yse", "yes"),
        ("restart", "of", "off"),
    ],
)
def test_a_value_that_is_no_name_tells_the_nearest(key, value, near):
    with pytest.raises(UsageError) as caught:
        RunConfig(**{key: value})
    assert caught.value.hint.startswith(f"did you mean {near}? ")


def test_unknown_key_without_a_near_one_lists_all():
    with pytest.raises(UsageError) as caught:
        RunConfig(zzz=1)
    assert "did you mean" not in caught.value.hint
    assert all(name in caught.value.hint for name in RunConfig.model_fields)


def test_unreadable_files_are_usage_errors(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        RunConfig.from_toml(tmp_path / "absent.toml")
    with pytest.raises(UsageError, match="cannot be read"):
        RunConfig.from_toml(tmp_path)
    broken = tmp_path / "broken.toml"
    broken.write_text("k = = 2\n")
    with pytest.raises(UsageError, match="not a TOML file.*line 1"):
        RunConfig.from_toml(broken)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="not a TOML file"):
        RunConfig.from_toml(binary)


def test_frozen_and_replace():
    config = RunConfig()
    with pytest.raises(ValidationError, match="frozen"):
        config.cfl = 0.1  # type: ignore[misc]
    assert config.replace(cfl=0.1).cfl == 0.1 and config.cfl == 0.5
    with pytest.raises(UsageError, match="cfl"):
        config.replace(cfl=-1)


def test_schema_describes_every_field_with_its_unit():
    schema = RunConfig.json_schema()
    json.dumps(schema)
    assert set(schema["properties"]) == set(RunConfig.model_fields)
    assert all(entry["description"].endswith(".") for entry in schema["properties"].values())
    lengths = ("smoothness", "presmooth", "diffusion")
    assert all("mm" in schema["properties"][name]["description"] for name in lengths)
    assert all(
        "voxels" in schema["properties"][name]["description"] for name in ("cfl", "half_width")
    )


@pytest.mark.parametrize("name", list(RunConfig.model_fields))
def test_expected_has_words_for_every_field(name):
    assert len(expected(name)) > 5


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"noise": 0.5, "reproducible": True}, "seed"),
    ],
)
def test_values_that_do_not_go_together_are_one_clear_line(values, key):
    with pytest.raises(UsageError) as caught:
        RunConfig(**values)
    message = str(caught.value)
    assert message.startswith(f"{key}: ") and " given, expected " in message and "\n" not in message
    assert RunConfig(**{**values, key: 3}) is not None


def test_settings_that_do_nothing_are_named():
    assert RunConfig().unused() == []
    assert RunConfig(flow="gradient", friction=3, diffusion=1, balance=2).unused() == ["friction"]
    assert RunConfig(flow="sobolev", noise=0.5, balloon=1).unused() == ["balloon", "noise"]
    assert RunConfig(
        energy="geodesic", flow="momentum:blend=0.5", balloon=1, epsilon=0
    ).unused() == ["epsilon"]
