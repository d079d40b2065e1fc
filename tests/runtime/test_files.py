"""Files are whole or not there, and take the place of files alone."""

from __future__ import annotations

import os
import socket
import threading
from pathlib import Path

import pytest

from dc_kernels.runtime.files import partial_name, replacing, write_whole

posix = pytest.mark.skipif(os.name != "posix", reason="devices and FIFOs of POSIX")


def test_a_file_is_replaced_or_left(tmp_path):
    path = tmp_path / "file.txt"
    write_whole(path, b"one")
    with replacing(path) as partial:
        partial.write_bytes(b"two")
        assert path.read_bytes() == b"one" and partial.suffix == ".txt" and partial.parent == tmp_path
    assert path.read_bytes() == b"two"
    with pytest.raises(RuntimeError), replacing(path) as partial:
        partial.write_bytes(b"three")
        raise RuntimeError
    assert path.read_bytes() == b"two" and list(tmp_path.iterdir()) == [path]


def test_links_are_followed(tmp_path):
    (tmp_path / "folder").mkdir()
    for name, start in (("there.txt", b"old"), ("new.txt", None)):
        real, link = tmp_path / "folder" / name, tmp_path / name
        if start:
            real.write_bytes(start)
        link.symlink_to(real)
        write_whole(link, b"content")
        assert link.is_symlink() and real.read_bytes() == b"content" and not real.is_symlink()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(OSError, match="loop was not written"):
        write_whole(tmp_path / "loop", b"content")


@posix
def test_nothing_but_a_file_is_replaced(tmp_path):
    fifo, folder, local = tmp_path / "fifo", tmp_path / "folder", tmp_path / "socket"
    os.mkfifo(fifo)
    folder.mkdir()
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(local))
        link = tmp_path / "link"
        link.symlink_to("/dev/null")
        named = {fifo: "a FIFO", folder: "a folder", local: "a socket", Path("/dev/null"): "a device", link: "a device"}
        before = {path: os.lstat(path).st_mode for path in named}
        for path, kind in named.items():
            with pytest.raises(OSError, match=f"{path} was not written: .* is {kind}, not a file"):
                write_whole(path, b"content")
        assert {path: os.lstat(path).st_mode for path in named} == before


def test_what_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "none" / "file.txt", tmp_path / "file" / "file.txt"):
        with pytest.raises(OSError, match=r"file\.txt was not written: "):
            write_whole(path, b"content")
    write_whole(tmp_path / ("n" * 240), b"content")  # as long as names may be, nearly


def test_writers_of_one_file_do_not_meet(tmp_path):
    path, errors = tmp_path / "file", []
    contents = [bytes([65 + k]) * 100_000 for k in range(4)]

    def write(content: bytes) -> None:
        try:
            for _ in range(10):
                write_whole(path, content)
                assert path.read_bytes() in contents
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=write, args=[content]) for content in contents]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not errors and list(tmp_path.iterdir()) == [path]
    assert len({partial_name(path) for _ in range(100)}) == 100
