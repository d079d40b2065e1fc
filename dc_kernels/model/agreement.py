"""Whether model, state and joints belong together."""

from __future__ import annotations

from dc_kernels.model.arrays import Joints, Model, State


def check_agreement(model: Model, state: State, joints: Joints) -> None:
    """Raise ValueError, naming the group, for arrays of another model, dtype, device or backend, or not finite."""
    for name, group in (("state", state), ("joints", joints)):
        for what in ("dtype", "device", "backend"):
            if getattr(group, what) != getattr(model, what):
                raise ValueError(
                    f"{name}.{what} is {getattr(group, what)}; it must be the model's, {getattr(model, what)}"
                )
    for axis in ("body", "world"):
        if state.sizes[axis] != model.sizes[axis]:
            raise ValueError(
                f"state has {state.sizes[axis]} on axis {axis!r}; it must be the model's {model.sizes[axis]}"
            )
    if joints.sizes["joint"] != model.joint_count:
        raise ValueError(f"joints has {joints.sizes['joint']}; it must be the model's {model.joint_count}")
    model.check("model")
    state.check("state")
    joints.check("joints")
