from accelsurf.report import file_entries


def test_describe_output_has_the_checksum_of_the_file(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"abc")
    entry = file_entries.describe_output(path, "trace")
    assert entry["sha256"] == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert (entry["path"], entry["kind"]) == (str(path), "trace")
