"""Limits of what is read, and files that are whole or not there."""

import errno
import os
import resource
import subprocess
import sys

import pytest
from PIL import Image, UnidentifiedImageError

from perception.geometry import files
from perception.geometry.files import (
    check_picture,
    check_pixels,
    check_size,
    read_bytes,
    read_json,
    read_text,
    read_toml,
    replace_file,
)
from tests.hostile_files import png_of_zeros


def test_file_beyond_its_limit_is_named_with_size_and_limit(tmp_path):
    path = tmp_path / "long.toml"
    path.write_bytes(b"a" * 1001)
    assert read_bytes(path, 1001) == b"a" * 1001
    for refuse in (read_bytes, read_text, read_json, read_toml, check_size):
        with pytest.raises(OSError, match="too large: 1,001 bytes, the limit is 1,000") as caught:
            refuse(path, 1000)
        assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(path))


def test_device_without_end_is_read_to_the_limit_only():
    with pytest.raises(OSError, match="too large: 1,001 bytes, the limit is 1,000"):
        read_bytes("/dev/zero", 1000)


def test_pipe_is_read_like_a_file(tmp_path):
    end, other = os.pipe()
    os.write(other, b"{}")
    os.close(other)
    assert read_json(f"/dev/fd/{end}", 10) == {}
    os.close(end)


@pytest.mark.parametrize("read", [read_json, read_toml])
@pytest.mark.parametrize(
    "content", [b"[" * 10**5, b"a = " + b"[" * 10**5, b'"\xff"', b"\0", b"9" * 5000]
)
def test_hostile_text_is_a_value_error(tmp_path, read, content):
    path = tmp_path / "text"
    path.write_bytes(content)
    with pytest.raises(ValueError):
        read(path, 2**20)


def test_picture_of_a_few_bytes_and_many_pixels_is_refused_by_its_header(tmp_path):
    path = tmp_path / "bomb.png"
    path.write_bytes(png_of_zeros(12_000, 12_000))
    assert path.stat().st_size < 40_000
    text = r"too large: 144,000,000 pixels \(12000 x 12000\), the limit is 33,554,432"
    most = Image.MAX_IMAGE_PIXELS
    with pytest.raises(OSError, match=text) as caught:
        check_picture(path)
    assert caught.value.filename == str(path)
    assert Image.MAX_IMAGE_PIXELS == most  # Pillow's own limit stays.
    path.write_bytes(png_of_zeros(12_000, 12_000)[:60])  # Refused although the rest is missing.
    with pytest.raises(OSError, match="144,000,000"):
        check_picture(path)
    path.write_bytes(png_of_zeros(8192, 4096))
    check_picture(path)


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"P5 x", b"#!/bin/sh", b"RIFF\0\0"])
def test_file_that_is_no_picture_is_refused_with_the_known_formats(tmp_path, content):
    path = tmp_path / "none.png"
    path.write_bytes(content)
    with pytest.raises(UnidentifiedImageError) as caught:
        check_picture(path)
    assert caught.value.filename == str(path) and "PNG, JPEG" in caught.value.strerror
    with pytest.raises(FileNotFoundError):
        check_picture(tmp_path / "missing.png")
    with pytest.raises(IsADirectoryError):
        check_picture(tmp_path)


def test_encoded_picture_has_a_limit_too(tmp_path, monkeypatch):
    path = tmp_path / "grey.png"
    path.write_bytes(png_of_zeros(100, 100))
    monkeypatch.setattr(files, "PICTURE", 50)
    with pytest.raises(OSError, match="bytes, the limit is 50"):
        check_picture(path)


def test_images_of_8k_are_allowed_and_larger_ones_not():
    check_pixels("video", 7680, 4320)
    with pytest.raises(OSError, match="8192 x 4320"):
        check_pixels("video", 8192, 4320)


def test_a_file_is_put_in_place_only_when_it_is_on_the_disk(tmp_path, monkeypatch):
    calls = []
    real_sync, real_replace = os.fsync, os.replace
    monkeypatch.setattr(files.os, "fsync", lambda f: (calls.append("sync"), real_sync(f)))
    monkeypatch.setattr(
        files.os, "replace", lambda a, b: (calls.append("replace"), real_replace(a, b))
    )
    replace_file(tmp_path / "x", lambda stream: stream.write(b"abc"))
    assert calls == ["sync", "replace", "sync"]
    assert (tmp_path / "x").read_bytes() == b"abc"


def test_a_file_may_be_read_by_whoever_may_read_others(tmp_path):
    (tmp_path / "other").write_bytes(b"abc")
    replace_file(tmp_path / "x", lambda stream: stream.write(b"abc"))
    assert (tmp_path / "x").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_a_full_disk_leaves_the_old_file_and_names_it(tmp_path):
    """The limit of a process on the size of its files stands for a full disk."""
    path = tmp_path / "x"
    path.write_bytes(b"old")

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    program = (
        "import sys; from perception.geometry.files import replace_file\n"
        "try: replace_file(sys.argv[1], lambda stream: stream.write(bytes(2000)))\n"
        "except OSError as error: print(error.filename, error.strerror)"
    )
    words = [sys.executable, "-c", program, str(path)]
    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=limit, check=True)
    assert done.stdout == f"{path} File too large\n"
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_missing_or_read_only_is_an_error_with_the_files_name(tmp_path):
    for path in (tmp_path / "none" / "x", "/proc/x"):
        with pytest.raises(OSError) as caught:
            replace_file(path, lambda stream: stream.write(b"abc"))
        assert caught.value.filename == str(path) and caught.value.strerror
