"""One buffer for every user, and values checked on their way in."""

import numpy as np
import pytest

import dc_kernels as dc
from dc_kernels._warp import groups
from dc_kernels.model import dtypes
from dc_kernels.model.arrays import State
from dc_kernels.model.checks import check_values
from dc_kernels.model.dtypes import aligned_zeros, float_dtype

SIZES = {"body": 5, "world": 2}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_numpy_and_torch_see_the_same_memory(backend, dtype):
    torch = pytest.importorskip("torch")
    state = State(SIZES, dtype, backend=backend)
    view, tensor = dc.to_numpy(state.position), dc.to_torch(state.position)
    address = state.position.ptr if backend == "warp" else state.position.ctypes.data
    assert view.ctypes.data == tensor.data_ptr() == address
    assert address % 64 == 0  # for SIMD loads
    assert tensor.shape == view.shape == (5, 2)
    assert tensor.dtype == getattr(torch, dtype)
    with pytest.raises(ValueError, match=r"position requires a gradient, which would be lost; give position\.detach"):
        state.assign("position", tensor.clone().requires_grad_())
    tensor[3, 1] = 2.5
    assert view[3, 1] == 2.5
    view[0, 0] = -1.0
    assert tensor[0, 0] == -1.0
    for show in (dc.to_numpy, dc.to_torch):
        with pytest.raises(TypeError, match=r"array is <State: .*; it must be an array of Warp or NumPy"):
            show(state)


def test_a_tensor_written_between_the_phases_is_the_start():
    """The path of a learned start: torch writes the impulses that the solver begins with."""
    pytest.importorskip("torch")
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_chain(builder.add_body(type=dc.BodyType.STATIC), [(5.0, 0.0), (-5.0, 0.0)])
    builder.add_discs([(0.0, 0.5)], 0.5)
    sim = dc.Simulation(*builder.finalize(), config=dc.SolverConfig(max_sweeps=0))
    sim.collide(0.01)
    dc.to_torch(sim.contacts.impulse)[0, 0] = 0.25
    sim.solve()  # no sweeps: the start is the answer
    assert sim.contacts.impulse.numpy()[0, 0] == 0.25
    mass = float(sim.model.numpy("mass")[1])
    assert sim.motion.numpy("solved")[1, 1] == pytest.approx(0.25 / mass - 9.8 * 0.01, rel=1e-5)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_assign_copies_values_of_the_right_kind(backend):
    state = State(SIZES, "float32", backend=backend)
    state.assign("position", np.arange(10.0).reshape(5, 2))
    np.testing.assert_array_equal(state.numpy("position"), np.arange(10.0).reshape(5, 2))
    for name, values, message in (
        ("position", np.zeros((5, 3)), r"position has shape \(5, 3\); it must be \(5, 2\)"),
        ("angle", [0.0, 0.0, np.nan, 0.0, 0.0], r"angle\[2\] is nan; it must be finite"),
        ("velocity", np.full((5, 2), np.inf), r"velocity\[0, 0\] is inf; it must be finite"),
        ("flags", [0.5, 0.0], r"flags\[0\] is 0.5; it must be an int32"),
        ("flags", [0, 2**40], r"flags\[1\] is 1099511627776; it must be an int32"),
        ("flags", [-1, 0], r"flags\[0\] is -1; it must be in \[0, 63\]"),  # no snapshot would bring it back
        ("angle", [True] * 5, r"angle is .*; it must be numbers of shape \(5,\)"),
        ("angle", ["a"] * 5, r"angle is .*; it must be numbers of shape \(5,\)"),
    ):
        with pytest.raises(ValueError, match=message):
            state.assign(name, values)


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_what_leads_kernels_through_memory_does_not_change_in_a_model_in_use(backend):
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_distance_joint(*builder.add_discs([(0, 0), (3, 0)], 1.0))
    model, state, joints = builder.finalize(backend=backend)
    kept = {name for group in (model, joints) for name, field in group.table.items() if field.points}
    assert kept >= {"body_start", "vertex_start", "shape_start", "shape_body", "shape_type", "joint_body_a"}
    assert kept.isdisjoint({"mass", "inv_mass", "body_type", "vertices", "shape_friction", "gravity"})
    group = {name: model if name in model.table else joints for name in kept}
    for name in kept:
        with pytest.raises(ValueError, match="read-only"):
            group[name].numpy(name)[0] = 1
        group[name].assign(name, group[name].numpy(name))  # a model that is being made by hand
    sim = dc.Simulation(model, state, joints)
    for name in kept:
        with pytest.raises(ValueError, match=f"{name} is in use by a simulation"):
            group[name].assign(name, group[name].numpy(name))
    for name in ("contact_start", "contact_count", "body_a", "body_b", "color"):
        with pytest.raises(ValueError, match="read-only"):
            sim.contacts.numpy(name)[...] = 1


@pytest.mark.parametrize("backend", ["warp", "numpy"])
def test_a_field_is_not_replaced_by_another_array(backend):
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_discs([(0, 0), (3, 0)], 1.0)
    model, state, joints = builder.finalize(backend=backend)
    sim = dc.Simulation(model, state, joints)
    for label in ("model", "state", "joints", "contacts", "rows", "motion", "stats", "pairs", "cache"):
        group = getattr(sim, label)
        kind = type(group).__name__.lower()
        for name in group.table:
            before = group.array(name)
            with pytest.raises(AttributeError, match=rf'{kind}\.assign\("{name}", values\)'):
                setattr(group, name, group.numpy(name).copy())
            assert group.array(name) is before
    with pytest.raises(AttributeError, match=r'state\.numpy\("position"\)\[\.\.\.\] = values'):
        state.position = np.ones((2, 2))
    state.assign("position", [(0, 5), (3, 5)])  # as the message says: the simulation goes on from there
    sim.step(0.01)
    np.testing.assert_allclose(state.numpy("position"), [(0, 5), (3, 5)], atol=0.01)
    with pytest.raises(
        KeyError, match="name is 'vel', no field of state; it must be one of position, angle, velocity, "
    ):
        state.assign("vel", np.zeros((2, 2)))


def _falling(change=lambda model, joints: None):
    """Two discs on a rope above a floor, and what changes before they are simulated."""
    builder = dc.ModelBuilder()
    builder.add_world()
    ground = builder.add_body(type=dc.BodyType.STATIC)
    builder.add_chain(ground, [(-5, 0), (5, 0)])
    builder.add_distance_joint(*builder.add_discs([(0, 1), (3, 1)], 1.0))
    model, state, joints = builder.finalize()
    change(model, joints)
    return dc.Simulation(model, state, joints)


def test_fields_of_a_model_in_use_act_at_the_next_step_or_are_refused():
    def change(model, joints):
        model.assign("gravity", [(3.0, -5.0)])
        joints.assign("joint_length", [2.5])

    late, early, plain = _falling(), _falling(change), _falling()
    change(late.model, late.joints)
    for sim in (late, early, plain):
        sim.step(0.01)
    for name in ("velocity", "position"):  # pulled aside, and together by the shorter rope
        np.testing.assert_allclose(late.state.numpy(name), early.state.numpy(name), atol=1e-3)
        assert abs(late.state.numpy(name) - plain.state.numpy(name)).max() > 0.01

    live = {name for name in late.model.table if late.model.writable(name)}
    assert live == set(late.model.live)
    for name in late.model.table.keys() - live:
        with pytest.raises(ValueError, match=rf"{name} is in use by a simulation.*model\.copy\(\)"):
            late.model.assign(name, late.model.numpy(name))
        with pytest.raises(ValueError, match="read-only"):
            late.model.numpy(name)[...] = 0


def test_a_copy_of_a_model_in_use_may_be_changed_and_simulated():
    sim = _falling()
    model = sim.model.copy()
    mass = np.array([0, 2, 4])
    model.assign("mass", mass)
    with pytest.raises(ValueError, match="inv_mass"):  # which belongs to it
        dc.Simulation(model, sim.state, sim.joints)
    model.assign("inv_mass", [0, 0.5, 0.25])
    model.assign("shape_friction", np.full(model.shape_count, 0.9))
    other = dc.Simulation(model, sim.state, sim.joints)
    other.run(3, 0.01)
    assert (other.contacts.numpy("friction")[: other.contacts.numpy("contact_count")[0]] == np.float32(0.9)).all()
    assert (sim.model.numpy("mass")[1:] != mass[1:]).all()


def test_an_index_array_edited_in_its_memory_is_found_by_the_next_simulation():
    builder = dc.ModelBuilder()
    builder.add_world()
    builder.add_box(builder.add_body(), 1.0, 1.0)
    builder.add_discs([(3, 0)], 1.0)
    for name, index, value, message in (
        ("vertex_start", 1, 10**6, r"model\.vertex_start\[2\] is 5; it must be ascending"),
        ("shape_body", 1, 7, r"model\.shape_body\[1\] is 7; it must be a body of its world 0 \(bodies 0 \.\. 1\)"),
        ("shape_type", 0, 7, r"model\.shape_type\[0\] is 7; it must be one of 0 \(DISC\), 1 \(POLYGON\)"),
        ("body_type", 0, 9, r"model\.body_type\[0\] is 9; it must be one of 0 \(STATIC\)"),
        ("inv_mass", 0, -1.0, r"model\.inv_mass\[0\] is -1\.0; it must be in \[0, 8e\+37\]"),
        ("cell_size", 0, 0.0, r"model\.cell_size\[0\] is 0\.0; it must be finite and > 0"),
    ):
        model, state, joints = builder.finalize()
        dc.to_numpy(model.array(name))[index] = value
        with pytest.raises(ValueError, match=message):
            dc.Simulation(model, state, joints)


def test_dtypes_other_than_float32_and_float64_are_refused():
    for dtype in ("float16", "int32", "complex64"):
        with pytest.raises(ValueError, match=dtype):
            float_dtype(dtype)


def test_bytes_by_axis_are_those_of_the_arrays():
    state = State(SIZES, "float64")
    assert state.nbytes() == sum(state.numpy(name).nbytes for name in state.table)
    assert state.nbytes_by_axis()["world"] == state.numpy("time").nbytes + state.numpy("flags").nbytes


def test_zeros_are_aligned_and_values_contiguous():
    for count in (1, 3, 1000):
        array = aligned_zeros((count, 2), np.dtype(np.float32))
        assert array.ctypes.data % 64 == 0
        assert not array.any()
    strided = np.arange(20.0)[::2]
    assert check_values("x", strided, (10,), np.dtype(np.float32)).flags.c_contiguous


def test_layouts_that_another_thread_forgets_meanwhile_do_without(monkeypatch):
    class Forgotten(dict):
        """What is kept in it is gone at once, as if a thread that makes other scenes had cleared it."""

        def __setitem__(self, key, value):
            super().__setitem__(key, value)
            self.clear()

    for module, name in ((dtypes, "_plans"), (groups, "_templates")):
        monkeypatch.setattr(module, name, Forgotten())
    builder = dc.ModelBuilder()
    builder.add_world(gravity=(0.0, 0.0))
    builder.add_disc(builder.add_body(velocity=(1.0, 0.0)), 0.5)
    sim = dc.Simulation(*builder.finalize("float64"))
    sim.run(10, 0.01)
    np.testing.assert_allclose(sim.state.numpy("position"), [[0.1, 0.0]], rtol=1e-12)
