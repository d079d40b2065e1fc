"""What a training of a network of the theses did, in words."""

from __future__ import annotations

from typing import Any


def describe(summary: dict[str, Any]) -> str:
    """Say what a training did, in a few lines."""
    metrics, choices = summary["metrics"], summary["choices"]
    lines = [
        f"{summary['network']}: {summary['parameters']:,} weights, {summary['epochs']} epochs, "
        f"{summary['steps']} steps, {summary['training_s']:.0f} s"
        + ("" if summary["complete"] else "; interrupted, --resume goes on"),
        f"{choices['optimizer']}, schedule {choices['schedule']}, rate {choices['rate']:.3g}",
    ]
    if metrics:
        loss, best, zero = metrics["loss"], summary["best_loss"], metrics["loss_zero"]
        lines.append(f"validation loss: last {loss:.4g}, best {best:.4g}, of zero impulses {zero:.4g}")
        lines += [
            f"squared error of {name} impulses, relative to zero impulses: {metrics[name]:.3g}; cached impulses "
            f"{metrics[f'{name}_cache']:.3g}; solution through the grid {metrics[f'{name}_grid']:.2g}"
            for name in ("normal", "tangential")
        ]
    lines.append(f"{summary['out']}: {', '.join(summary['files'])}")
    return "\n".join(lines)
