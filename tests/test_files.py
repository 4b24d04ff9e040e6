"""Files are written whole or not at all."""

import pytest

from hexopt.errors import InputError
from hexopt.files import write_whole


def test_text_and_bytes_are_written(tmp_path):
    assert write_whole(tmp_path / "a.txt", "ρ = γ\n").read_bytes() == "ρ = γ\n".encode()
    assert write_whole(str(tmp_path / "b"), b"\x00\xff").read_bytes() == b"\x00\xff"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.txt", "b"]


def test_an_existing_file_is_replaced(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("a long text that stood here before")
    assert write_whole(target, "new").read_text() == "new"


@pytest.mark.parametrize("place", ["missing/a.txt", "file/a.txt", "folder"])
def test_a_wrong_place_is_one_line_and_leaves_nothing(tmp_path, place):
    (tmp_path / "file").write_text("here")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written") as caught:
        write_whole(tmp_path / place, "new")
    assert "\n" not in str(caught.value)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "folder"]


def test_an_interrupted_write_leaves_the_old_file(tmp_path, monkeypatch):
    target = write_whole(tmp_path / "a.txt", "old")

    def fail(self, other):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", fail)
    with pytest.raises(InputError, match="No space left"):
        write_whole(target, "new")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]
