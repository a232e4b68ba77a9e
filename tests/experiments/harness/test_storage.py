"""Files that are whole and checked, and the lock of a result folder."""

import errno
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from experiments.harness import storage
from experiments.harness.contract import ExperimentError
from experiments.harness.storage import read_checked, write_checked, write_whole

HOLD = """
import pathlib, sys, time
from experiments.harness import storage
stream = storage.lock(pathlib.Path(sys.argv[1]))
print("taken", flush=True)
time.sleep(60)
"""


def test_a_folder_in_use_names_process_host_and_time_and_is_free_when_its_owner_dies(tmp_path):
    words = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as owner:
        try:
            assert owner.stdout.readline() == "taken\n"
            expected = rf"process {owner.pid} on {os.uname().nodename} since 20\d\d-"
            with pytest.raises(ExperimentError, match=expected):
                storage.lock(tmp_path)
        finally:
            owner.send_signal(signal.SIGKILL)
    with storage.lock(tmp_path):
        with pytest.raises(ExperimentError, match=f"in use by process {os.getpid()} on"):
            storage.lock(tmp_path)
    storage.lock(tmp_path).close()


def test_an_owner_who_is_about_to_say_who_it_is_is_waited_for(tmp_path, monkeypatch):
    with storage.lock(tmp_path):
        path = tmp_path / ".lock"
        words = path.read_text()
        path.write_text("")
        monkeypatch.setattr(time, "sleep", lambda _: path.write_text(words))
        with pytest.raises(ExperimentError, match=f"in use by process {os.getpid()} on"):
            storage.lock(tmp_path)
        monkeypatch.setattr(time, "sleep", lambda _: path.write_text(""))
        path.write_text("")
        with pytest.raises(ExperimentError, match="in use by another run; "):
            storage.lock(tmp_path)


def test_every_flipped_bit_and_every_missing_end_is_noticed(tmp_path):
    path = tmp_path / "file"
    content = np.random.default_rng(0).bytes(8)
    write_checked(path, content)
    whole = path.read_bytes()
    assert read_checked(path) == content and list(tmp_path.iterdir()) == [path]
    for bit in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        assert read_checked(path) is None
    for damaged in (*(whole[:size] for size in range(len(whole))), whole + b"\0", bytes(40)):
        path.write_bytes(damaged)
        assert read_checked(path) is None
    path.unlink()
    assert read_checked(path) is None


@pytest.mark.parametrize("refusal", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_what_the_disk_refuses_is_named_and_the_file_before_it_stays(
    tmp_path, monkeypatch, refusal
):
    path = tmp_path / "file"
    write_whole(path, b"before")

    def fail(_):
        raise OSError(refusal, os.strerror(refusal))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(ExperimentError, match=rf"^{path}: {os.strerror(refusal)}; ") as caught:
        write_whole(path, b"after")
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == b"before" and list(tmp_path.iterdir()) == [path]


def test_a_file_is_on_the_disk_before_it_has_its_name(tmp_path, monkeypatch):
    order = []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda *words: (order.append("fsync"), fsync(*words)))
    monkeypatch.setattr(os, "replace", lambda *words: (order.append("replace"), replace(*words)))
    write_whole(tmp_path / "file", b"x")
    assert order == ["fsync", "replace", "fsync"]  # The file, and then the folder.


def test_other_errors_of_the_system_come_as_they_are(tmp_path):
    with pytest.raises(FileNotFoundError), storage.disk_errors(tmp_path):
        (tmp_path / "missing").read_bytes()
