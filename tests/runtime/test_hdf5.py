"""HDF5 files from strangers: what leads elsewhere, or declares more than it holds, is refused before it is read."""

from __future__ import annotations

import os
import resource
import sys
import time
import zlib

import h5py
import hdf5plugin
import numpy as np
import pytest
import zstandard

from dc_kernels.runtime import hdf5
from dc_kernels.runtime.hdf5 import image, plain_name, reading


def external(file):
    file.create_dataset("a/raw", (100,), "u1", external=[("/etc/passwd", 0, 100)])


def virtual(source):
    def add(file):
        layout = h5py.VirtualLayout((4,), "f4")
        layout[:] = h5py.VirtualSource(source, "data", (4,), "f4")
        file.create_virtual_dataset("a/shown", layout)

    return add


def bomb(file):
    """Chunks of a gigabyte in a few kilobytes, compressed twice as HDF5 would decompress them."""
    once = zlib.compress(bytes(2**24))
    data = file.create_dataset("a/bomb", (2**27,), "u1", chunks=(2**27,), compression="gzip")
    data.id.write_direct_chunk((0,), zlib.compress(once * 8))


def zstd_bomb(file):
    """Zeros in zstd, of which a stored byte makes thirty thousand; a gigabyte in all."""
    data = file.create_dataset("a/bomb", (2**30,), "u1", chunks=(2**26,), **hdf5plugin.Zstd())
    for first in range(0, 2**30, 2**26):
        data.id.write_direct_chunk((first,), zstandard.compress(bytes(2**26)))


def filtered(**options):
    return lambda file: file.create_dataset("odd", data=np.ones(10), chunks=(10,), **options)


def twice(file):
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_chunk((10,))
    properties.set_deflate(1)
    properties.set_deflate(1)
    space = h5py.h5s.create_simple((10,))
    h5py.h5d.create(file.id, b"odd", h5py.h5t.NATIVE_DOUBLE, space, properties)
    file["odd"][...] = np.ones(10)


REFUSED = [
    (zstd_bomb, "a/bomb: the datasets up to this one hold 1073741824 bytes of values; the file has"),
    (filtered(compression="lzf"), r"odd has the filters \(32000,\); they must be shuffle"),
    (filtered(**hdf5plugin.Blosc()), r"odd has the filters \(32001,\)"),
    (filtered(scaleoffset=2), r"odd has the filters \(6,\)"),
    (twice, r"odd has the filters \(1, 1\)"),
    (lambda f: f.__setitem__("a/link", h5py.ExternalLink("/etc/x.h5", "/x")), "a/link is a link to another file"),
    (external, r"a/raw has its values in another file \(external storage\)"),
    (virtual("other.h5"), r"a/shown is virtual: it shows values of \['other.h5'\]"),
    (virtual("."), "a/shown is virtual"),
    (lambda f: f.create_dataset("big", (10**10,), "f8"), "big declares 80000000000 bytes of values, for which 0 are"),
    (
        lambda f: f.create_dataset("big", (10**10,), "f8", chunks=(10**6,), compression="gzip"),
        r"big of shape \(10000000000,\) has 0 of its 10000 chunks stored",
    ),
    (lambda f: f.create_dataset("one", (1,), "f8", maxshape=(None,), chunks=(10**8,)), "one of shape"),
    (bomb, "a/bomb declares 134217728 bytes of values, for which .* are stored; these can hold"),
]


@pytest.mark.parametrize(("build", "match"), REFUSED)
def test_what_leads_elsewhere_or_is_not_there_is_refused(build, match, tmp_path):
    path = tmp_path / "file.h5"
    path.write_bytes(image(build))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match=rf"file\.h5: {match}"), reading(path):
        pass
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before + 100_000  # kB


def test_what_is_usual_is_read(tmp_path):
    def build(file):
        file["scalar"], file["text"], file["none"] = 3.0, "abc", h5py.Empty("f4")
        file["rows"] = np.arange(1000)
        file.create_dataset("empty", (0, 3), "f8")
        for level in (1, 9):  # zeros compress as far as gzip goes
            file.create_dataset(f"zeros{level}", data=np.zeros(3 * 10**6), compression=level, chunks=(10**6,))
        file.create_dataset("edge", data=np.ones(1000), chunks=(999,), shuffle=True, compression=4, fletcher32=True)
        file.create_dataset("zstd", data=np.zeros(10**5), chunks=(10**4,), shuffle=True, **hdf5plugin.Zstd())
        file["soft"], file["again"] = h5py.SoftLink("/rows"), file["rows"]
        file["loop"] = file["/"]
        file["gone"] = h5py.SoftLink("/nothing")

    path = tmp_path / "file.h5"
    path.write_bytes(image(build))
    with reading(path) as file:
        np.testing.assert_array_equal(file["soft"], np.arange(1000))
        assert file["scalar"][()] == 3.0 and not file["zeros9"][...].any() and not file["zstd"][...].any()
    with pytest.raises(ValueError, match=r"file\.h5 is damaged: .*not found"), reading(path) as file:
        file["gone"]
    with pytest.raises(ValueError, match=r"file\.h5: negative"), reading(path) as file:
        raise ValueError("negative")


def test_chunks_that_share_their_bytes_are_refused(tmp_path):
    """A file may name one place for many datasets; together they must not take more than there is."""

    def build(file):
        for k in range(3):
            file[f"d{k}"] = np.full(10**4, k, "f8")

    content = bytearray(image(build))
    path = tmp_path / "file.h5"
    path.write_bytes(content)
    with h5py.File(path) as file:
        places = [file[f"d{k}"].id.get_offset() for k in range(3)]
    for k in (1, 2):
        at = content.index(int(places[k]).to_bytes(8, "little"))
        content[at : at + 8] = int(places[0]).to_bytes(8, "little")
    path.write_bytes(content[: places[1]] + content[places[2] + 8 * 10**4 :])
    with pytest.raises(ValueError, match=r"file\.h5"), reading(path) as file:
        file["d2"][...]


def test_virtual_datasets_show_files_beside_theirs(tmp_path):
    path = tmp_path / "index.h5"
    with h5py.File(tmp_path / "part.h5", "w") as file:
        file["data"] = np.arange(4, dtype="f4")
    path.write_bytes(image(virtual("part.h5")))
    with reading(path, virtual=True) as file:
        np.testing.assert_array_equal(file["a/shown"], np.arange(4))
    assert not plain_name("part%b.h5") and not plain_name("") and plain_name("shard-00001.h5")
    for source in ("/etc/part.h5", "../part.h5", "folder/part.h5", ".", ".."):
        path.write_bytes(image(virtual(source)))
        assert not plain_name(source)
        with pytest.raises(ValueError, match="a/shown is virtual"), reading(path, virtual=True):
            pass


def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    for name, kind in (("fifo", "a FIFO"), ("", "a folder")):
        with pytest.raises(OSError, match=f"is {kind}, not a file"), reading(tmp_path / name):
            pass
    with pytest.raises(OSError, match="/dev/zero is a device"), reading("/dev/zero"):
        pass
    with pytest.raises(FileNotFoundError), reading(tmp_path / "none.h5"):
        pass
    for content in (b"", b"no file of HDF5's", bytes(image(lambda file: file.__setitem__("a", np.ones(100))))[:-200]):
        (tmp_path / "file.h5").write_bytes(content)
        with (
            pytest.raises(ValueError, match=r"file\.h5 is not an HDF5 file, or is truncated"),
            reading(tmp_path / "file.h5"),
        ):
            pass


def test_a_file_is_looked_at_once_until_it_changes(tmp_path, monkeypatch):
    looks, check = [], hdf5._check
    monkeypatch.setattr(hdf5, "_check", lambda *args: (looks.append(1), check(*args)))
    path, good, bad = tmp_path / "file.h5", image(virtual("part.h5")), image(virtual("p/rt.h5"))
    assert len(good) == len(bad)
    path.write_bytes(good)
    assert hdf5.SETTLE_NS >= 10**9
    monkeypatch.setattr(hdf5, "SETTLE_NS", 10**12)  # whatever a busy machine makes of what the clock's tick needs
    for _ in range(2):  # it is too young: a change within the clock's tick would not show
        with reading(path, virtual=True):
            pass
    assert len(looks) == 2
    monkeypatch.setattr(hdf5, "SETTLE_NS", 0)
    for _ in range(3):
        with reading(path, virtual=True):
            pass
    assert len(looks) == 3
    with pytest.raises(ValueError, match="is virtual"), reading(path):  # what may be shown there is no matter here
        pass
    before = path.stat()
    while path.stat().st_ctime_ns == before.st_ctime_ns:  # until the file system's clock has ticked
        with open(path, "r+b") as file:
            file.write(bad)
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
        time.sleep(1e-3)
    assert (path.stat().st_size, path.stat().st_mtime_ns) == (before.st_size, before.st_mtime_ns)
    with pytest.raises(ValueError, match="a/shown is virtual"), reading(path, virtual=True):
        pass


def test_zstd_without_its_plugin_is_an_error_that_says_what_to_install(tmp_path, monkeypatch):
    path = tmp_path / "file.h5"
    path.write_bytes(image(filtered(**hdf5plugin.Zstd())))
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    wanted = r"hdf5plugin: in a clone of deep-contact, pip install -e '\.\[pipeline\]'"
    with pytest.raises(ImportError, match=wanted), reading(path):
        pass
