"""`remind backbones`: what patch features can come from."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Annotated

from tyro.conf import Positional, arg

from remind_jax.cli.flags import flags
from remind_jax.printing.terminal import print_lines, print_table

# What needs a word below the list; the other states are "none needed" and "here".
_NOTES = {
    "on first use": "are fetched, checked and converted when the name is first used",
    "on request": "are given out by their publisher on request; then as above, with a token",
    "your file": "come from a file of yours: vit with --weights, onnx as onnx:FILE",
}


@dataclasses.dataclass(frozen=True)
class Row:
    """What is known of one name."""

    name: str
    weights: str  # "none needed", "here", or a key of `_NOTES`
    license: str | None = None
    license_url: str | None = None
    patch_px: int | None = None
    dim: int | None = None
    num_bytes: int | None = None  # of the converted file
    path: str | None = None  # of the converted file, if it is here
    page: str | None = None  # where a person reads about the weights


@flags
class Backbones:
    """List what patch features can come from, with license and size.

    Weights are fetched when a name is first used, if their publisher allows it.

    Examples:
      remind backbones
      remind backbones dinov2-vits14 --json
    """

    # only these; all if left out
    names: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    json: bool = False  # print the list as JSON

    def execute(self) -> None:
        """Prints the list."""
        from remind_jax.backbone.registry import DEFAULT_BACKBONE, check_name, list_backbones
        from remind_jax.backbone.vit_variants import VARIANTS

        for name in self.names:
            check_name(name)
        # The default, networks in the order of their table, then what takes a file.
        order = [DEFAULT_BACKBONE, *VARIANTS]
        order += [name for name in list_backbones() if name not in order]
        rows = [describe(name) for name in self.names or order]
        if self.json:
            print(json.dumps([dataclasses.asdict(row) for row in rows], indent=1))
        else:
            _print(rows)


def describe(name: str) -> Row:
    """What is known of a registered backbone."""
    from remind_jax.backbone.published_weights import PUBLISHED
    from remind_jax.backbone.registry import DEFAULT_BACKBONE, get_backbone
    from remind_jax.backbone.vit_variants import TERMS, VARIANTS
    from remind_jax.backbone.vit_weights import leaf_shapes, look_for_weights

    if name not in VARIANTS:
        if name != DEFAULT_BACKBONE:
            return Row(name, "your file")
        default = get_backbone(name)
        return Row(name, "none needed", "Apache-2.0", None, default.patch_px, default.dim)
    variant, published = VARIANTS[name], PUBLISHED.get(name)
    terms, (path, _) = TERMS[variant.family], look_for_weights(name)
    is_free = published is not None and not published.is_gated
    return Row(
        name,
        "here" if path is not None else "on first use" if is_free else "on request",
        terms.license,
        terms.license_url,
        variant.patch_px,
        variant.width,
        4 * sum(math.prod(shape) for shape in leaf_shapes(variant).values()),
        None if path is None else str(path),
        None if published is None else published.page,
    )


def _print(rows: list[Row]) -> None:
    lines = [("name", "license", "MiB", "patch", "dim", "weights")]
    for row in rows:
        mib = "" if row.num_bytes is None else f"{row.num_bytes / 2**20:.0f}"
        patch, dim = ("" if n is None else str(n) for n in (row.patch_px, row.dim))
        lines.append((row.name, row.license or "", mib, patch, dim, row.weights))
    print_table(lines, is_text=(0, 1, 5))
    states = {row.weights for row in rows}
    for state, says in _NOTES.items():
        if state in states:
            print_lines(f"Weights '{state}' {says}.")
