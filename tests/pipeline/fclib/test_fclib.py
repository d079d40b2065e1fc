"""FCLIB's HDF5 layout: what is read, written, refused; scenes exported and files solved from the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from dc_kernels.delassus import DelassusProblem, solve
from pipeline.cli import main
from pipeline.fclib.files import FclibProblem, problem_files, read_fclib, write_fclib

DATA = Path(__file__).resolve().parents[4] / "shared" / "data" / "fc2d"
FIELDS = ("row_start", "column", "block", "q", "mu", "bilateral")
# two contacts that share a body, the second of them with its own mass beside
W = np.array([[2.0, 0.5, 1.0, 0.0], [0.5, 3.0, 0.0, -1.0], [1.0, 0.0, 2.5, 0.0], [0.0, -1.0, 0.0, 2.0]])
Q = np.array([-1.0, 0.5, -2.0, 0.1])
MU = np.array([0.3, 0.7])


def compressed(w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pointers, indices and values of the columns of a dense matrix, without its zeros."""
    columns, rows = np.nonzero(w.T)
    return np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=w.shape[1]))]), rows, w[rows, columns]


def put_matrix(file: Any, name: str, w: np.ndarray, nz: int = -1, scalar: Any = np.int32) -> None:
    """A matrix as FCLIB's C code writes it: nz -1 columns, -2 rows, else triplets with rows in p."""
    if nz == -1:
        p, i, x = compressed(w)
    elif nz == -2:
        p, i, x = compressed(w.T)
    else:
        p, i = np.nonzero(w)
        x = w[p, i]
        nz = len(x)
    for what, value in (("m", w.shape[0]), ("n", w.shape[1]), ("nz", nz), ("nzmax", len(x))):
        file[f"{name}/{what}"] = scalar(value) if scalar is np.int32 else np.array([value], np.int32)
    file[f"{name}/p"], file[f"{name}/i"], file[f"{name}/x"] = p.astype(np.int32), i.astype(np.int32), x


def put(path: Path, nz: int = -1, scalar: Any = list) -> Path:
    """A small file."""
    with h5py.File(path, "w") as file:
        file["fclib_local/spacedim"] = np.array([2], np.int32)
        put_matrix(file, "fclib_local/W", W, nz, scalar)
        file["fclib_local/vectors/q"], file["fclib_local/vectors/mu"] = Q, MU
    return path


def assert_same(a: DelassusProblem, b: DelassusProblem) -> None:
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.parametrize("scalar", [np.int32, list])
@pytest.mark.parametrize("nz", [-1, -2, 0])
def test_layouts(tmp_path, nz, scalar):
    problem = read_fclib(put(tmp_path / "a.hdf5", nz, scalar)).problem
    r = np.array([0.3, -0.2, 1.0, 0.4])
    np.testing.assert_allclose(problem.velocity(r).ravel(), W @ r + Q, rtol=1e-15)
    np.testing.assert_array_equal(problem.mu, MU)


def test_spare_room_is_not_read(tmp_path):
    """There may be more room (nzmax) than is used."""
    path = put(tmp_path / "a.hdf5")
    usual = read_fclib(path).problem
    with h5py.File(path, "r+") as file:
        for name in ("i", "x"):
            values = file[f"fclib_local/W/{name}"][...]
            del file[f"fclib_local/W/{name}"]
            file[f"fclib_local/W/{name}"] = np.concatenate([values, np.full(3, 77, values.dtype)])
    assert_same(read_fclib(path).problem, usual)


def test_round_trip(tmp_path):
    first = read_fclib(put(tmp_path / "a.hdf5"))
    draw = np.random.default_rng(0)
    content = FclibProblem(
        problem=first.problem,
        info={"title": "two contacts", "description": "µ and\nlines", "math_info": ""},
        attributes={"source": "a test"},
        solution=solve(first.problem).impulses,
        guesses=list(draw.normal(size=(2, 2, 2))),
    )
    write_fclib(tmp_path / "b.hdf5", content)
    again = read_fclib(tmp_path / "b.hdf5")
    assert_same(again.problem, first.problem)
    assert again.info == content.info and again.attributes == content.attributes
    np.testing.assert_array_equal(again.solution, content.solution)
    np.testing.assert_array_equal(again.guesses, content.guesses)
    write_fclib(tmp_path / "c.hdf5", again)
    with h5py.File(tmp_path / "b.hdf5") as b, h5py.File(tmp_path / "c.hdf5") as c:
        names: list[str] = []
        b.visit(names.append)
        for name in names:
            if isinstance(b[name], h5py.Dataset):
                np.testing.assert_array_equal(b[name][()], c[name][()], err_msg=name)
        # as FCLIB's own reader wants it
        assert b["fclib_local/W/nz"][...].tolist() == [-1] and b["fclib_local/W/m"].dtype == np.int32
        assert b["guesses/number_of_guesses"][...].tolist() == [2]
        np.testing.assert_allclose(b["solution/u"], W @ b["solution/r"][...] + Q)


def test_equations(tmp_path):
    """V^T r + R l + s = 0 beside the contacts: a bilateral row."""
    v, r_matrix, s = np.array([[0.5], [0.0], [-0.25], [0.1]]), np.array([[2.0]]), np.array([0.4])
    with h5py.File(put(tmp_path / "a.hdf5"), "r+") as file:
        put_matrix(file, "fclib_local/V", v, -2)
        put_matrix(file, "fclib_local/R", r_matrix)
        file["fclib_local/vectors/s"] = s
    content = read_fclib(tmp_path / "a.hdf5")
    problem = content.problem
    assert problem.bilateral.tolist() == [False, False, True]
    for method in ("anderson", "newton", "auto"):
        x = solve(problem, method, tolerance=1e-11).impulses
        r, multiplier = x[:2].ravel(), x[2, 0]
        np.testing.assert_allclose(v.T @ r + r_matrix @ [multiplier] + s, 0.0, atol=1e-10)
        # and the contacts solve what is left with the multiplier eliminated
        schur = W - v @ v.T / 2.0
        row, column = np.divmod(np.arange(16), 4)
        rest = DelassusProblem.from_compressed(schur.ravel(), row, column, Q - v[:, 0] * 0.2, MU, layout="triplets")
        assert rest.natural_map(r) < 1e-9
    write_fclib(tmp_path / "b.hdf5", FclibProblem(problem=problem, solution=x, guesses=[x]))
    again = read_fclib(tmp_path / "b.hdf5")
    assert_same(again.problem, problem)
    np.testing.assert_array_equal(again.solution, x)
    with h5py.File(tmp_path / "b.hdf5") as file:
        assert file["fclib_local/V/m"][0] == 4 and file["fclib_local/V/n"][0] == 1
        np.testing.assert_array_equal(file["solution/l"], [multiplier])


# ---------------------------------------------------------------------- real files


def real_files() -> list[Path]:
    return problem_files(DATA) if DATA.is_dir() else []


@pytest.mark.parametrize("path", real_files(), ids=lambda path: path.stem)
def test_real_problems(path, tmp_path):
    """All are solved far below what the field asks for, and survive a round trip bit for bit."""
    content = read_fclib(path)
    solution = solve(content.problem, tolerance=1e-10)
    assert solution.converged and content.problem.natural_map(solution.impulses) <= 1e-10
    write_fclib(tmp_path / "a.hdf5", content)
    again = read_fclib(tmp_path / "a.hdf5")
    assert_same(again.problem, content.problem)
    assert again.attributes == content.attributes


@pytest.mark.skipif(not DATA.is_dir(), reason="the problems are not part of the repository")
def test_granular_flow_in_few_sweeps():
    """Plain Gauss-Seidel leaves what is published of this file after 10, 100, 300 sweeps; 160 accelerated ones do."""
    problem = read_fclib(DATA / "fc2d_granularflowonwall_02020_00213.hdf5").problem
    plain = solve(problem, "pgs", tolerance=1e-8, max_sweeps=300, every=10).history
    np.testing.assert_allclose(plain[[0, 9, 29], 1], [4.7e-2, 6.1e-3, 1.3e-3], rtol=0.03)
    for method in ("aitken", "anderson", "hybrid", "auto"):
        assert solve(problem, method, tolerance=1e-4, scaled=False, every=1).sweeps <= 160, method


# ---------------------------------------------------------------------- what is refused


def replaced(name: str, value: Any):
    def change(file: Any) -> None:
        del file[name]
        if value is not None:
            file[name] = value

    return change


LOCAL = "fclib_local"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (replaced(f"{LOCAL}/W/x", None), "fclib_local/W/x is missing"),
        (replaced(f"{LOCAL}/vectors/mu", None), "fclib_local/vectors/mu is missing"),
        (replaced(f"{LOCAL}/spacedim", np.array([3], np.int32)), "fclib_local/spacedim is 3; it must be 2"),
        (replaced(f"{LOCAL}/spacedim", "two"), "fclib_local/spacedim has dtype object; it must be of integers"),
        (replaced(LOCAL, None), "fclib_local is missing: .* it holds nothing"),
        (replaced(f"{LOCAL}/vectors/q", Q[:3]), r"vectors/q has shape \(3,\); it must be \(4,\)"),
        (replaced(f"{LOCAL}/vectors/q", np.r_[Q[:3], np.nan]), r"vectors/q\[3\] is nan; it must be finite"),
        (replaced(f"{LOCAL}/vectors/mu", [0.5, -1.0]), r"vectors/mu\[1\] is -1.0; it must be finite and >= 0"),
        (replaced(f"{LOCAL}/W/m", np.array([6], np.int32)), "fclib_local/W is 6 x 4; it must be square"),
        (replaced(f"{LOCAL}/W/m", np.array([6, 6], np.int32)), r"W/m has shape \(2,\); it must be \(\)"),
        (replaced(f"{LOCAL}/W/n", np.array([-4], np.int32)), "W/n is -4"),
        (replaced(f"{LOCAL}/W/nz", np.array([-3], np.int32)), "W/nz is -3; it must be -1"),
        (replaced(f"{LOCAL}/W/nz", np.array([99], np.int32)), "W/p has 5 entries; nz is 99"),
        (replaced(f"{LOCAL}/W/p", np.array([0, 3, 2, 8, 10])), r"W/p\[2\] is 2; it must be ascending"),
        (replaced(f"{LOCAL}/W/p", np.array([0, 3, 5, 8, 2**40])), "W/i has 10 entries; it must have 1099511627776"),
        (replaced(f"{LOCAL}/W/p", np.array([0, 3, 6])), r"W/p has shape \(3,\); it must be \(5,\)"),
        (replaced(f"{LOCAL}/W/i", np.zeros(3, int)), "W/i has 3 entries; it must have 10"),
        (replaced(f"{LOCAL}/W/i", np.full(10, 4)), r"W/i\[0\] is 4; it must be in \[0, 3\]"),
        (replaced(f"{LOCAL}/W/i", np.zeros(10)), "W/i has dtype float64; it must be of integers"),
        (replaced(f"{LOCAL}/W/x", np.full(10, np.inf)), r"W/x\[0\] is inf; it must be finite"),
        (replaced(f"{LOCAL}/W/x", -np.ones(10)), r"fclib_local: the normal diagonal of W\[0\] is -1.0; it must be > 0"),
    ],
)
def test_bad_files(tmp_path, change, message):
    path = put(tmp_path / "bad.hdf5")
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(ValueError, match=message) as caught:
        read_fclib(path)
    assert str(caught.value).startswith(str(path))


def test_foreign_truncated_and_missing(tmp_path):
    text = tmp_path / "a.hdf5"
    text.write_text("not HDF5")
    with pytest.raises(ValueError, match=r"a\.hdf5 is not an HDF5 file, or is truncated"):
        read_fclib(text)
    with pytest.raises(FileNotFoundError):
        read_fclib(tmp_path / "b.hdf5")
    other = tmp_path / "c.hdf5"
    with h5py.File(other, "w") as file:
        file["fclib_global/spacedim"] = [2]
    with pytest.raises(ValueError, match="it holds fclib_global"):
        read_fclib(other)
    whole = put(tmp_path / "d.hdf5").read_bytes()
    for share in (0.02, 0.3, 0.6, 0.9, 0.999):
        cut = tmp_path / "e.hdf5"
        cut.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=r"e\.hdf5"):
            read_fclib(cut)
    with pytest.raises(ValueError, match=r"no \.hdf5 or \.h5 file"):
        (tmp_path / "empty").mkdir()
        problem_files(tmp_path / "empty")


def test_nothing_is_left_of_a_file_that_fails(tmp_path):
    content = read_fclib(put(tmp_path / "a.hdf5"))
    with pytest.raises(ValueError, match="solution has shape"):
        write_fclib(tmp_path / "b.hdf5", FclibProblem(problem=content.problem, solution=np.zeros((5, 2))))
    with pytest.raises(TypeError):
        write_fclib(tmp_path / "b.hdf5", FclibProblem(problem=content.problem, attributes={"x": object()}))  # type: ignore[dict-item]
    assert [path.name for path in tmp_path.iterdir()] == ["a.hdf5"]


# ---------------------------------------------------------------------- command line


def last_json(capsys: Any) -> dict[str, Any]:
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def test_export_then_solve(tmp_path, capsys):
    pattern = str(tmp_path / "in" / "{scene}-{step}-{world}.hdf5")
    command = ["fclib", "export", "stack", "--bodies", "4", "--worlds", "2", "--world", "0", "1", "--dtype", "float64"]
    main([*command, "--step", "3", "10:20:5", "--tolerance", "1e-9", "--out", pattern, "--json"])
    result = last_json(capsys)
    assert [(row["step"], row["world"]) for row in result["files"]] == [(s, w) for s in (3, 10, 15, 20) for w in (0, 1)]
    assert all(row["residual"] < 1e-5 for row in result["files"])  # the simulation's own solution
    content = read_fclib(tmp_path / "in" / "stack-10-1.hdf5")
    assert content.problem.count == 8 and len(content.guesses) == 1 and "step 10" in content.info["title"]
    main(["fclib", "solve", str(tmp_path / "in"), "--tolerance", "1e-9", "--out", str(tmp_path / "out"), "--json"])
    result = last_json(capsys)
    assert result["converged"] and len(result["files"]) == 8
    for name, row in result["files"].items():
        solved = read_fclib(tmp_path / "out" / name)
        assert solved.problem.natural_map(solved.solution) == row["residual"] <= 1e-9
    main(["fclib", "solve", str(tmp_path / "out" / "stack-3-0.hdf5"), "--start", "solution", "--tolerance", "1e-9"])
    assert "stack-3-0.hdf5" in capsys.readouterr().out


def test_export_with_joints(tmp_path, capsys):
    out = tmp_path / "chain.hdf5"
    # ten links fall onto nothing: no contact, and so nothing that FCLIB could hold
    main(["fclib", "export", "chain", "--step", "5", "--out", str(out), "--json"])
    assert last_json(capsys) == {"scene": "chain", "complete": True, "files": [], "empty": [[5, 0]]}
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["export", "stack", "--step", "0"], "step is '0'; steps begin at 1"),
        (["export", "stack", "--step", "9:3"], "step is '9:3'"),
        (["export", "stack", "--step", "x"], "step is 'x'"),
        (["export", "stack", "--step", "1:2:0"], "step is '1:2:0'"),
        (["export", "stack", "--world", "1"], "world is 1; it must lie in [0, 1)"),
        (["export", "stack", "--step", "1:3", "--out", "x.hdf5"], "one name for several problems"),
        (["export", "stack", "--out", "{seed}.hdf5"], "its fields may be"),
        (["solve", "nowhere.hdf5"], "nowhere.hdf5: there is no such file"),
        (["solve", "nowhere.hdf5", "--start", "cache"], "start is 'cache'"),
    ],
)
def test_bad_commands(arguments, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main(["fclib", *arguments])
    assert caught.value.code == 2 and message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_bench_ends_where_no_file_can_be_read(tmp_path, capsys):
    """Files of others that are refused are named; with none left there is nothing to measure."""
    from bench.error_time import fc2d as bench_fc2d

    with h5py.File(tmp_path / "foreign.hdf5", "w") as file:
        file["something"] = 1.0
    for folder, message in ((tmp_path, "holds a problem that can be read"), (tmp_path / "none", "no such file")):
        with pytest.raises(SystemExit) as ended:
            bench_fc2d.measure(True, str(folder))
        assert ended.value.code == 2
        assert message in capsys.readouterr().err
