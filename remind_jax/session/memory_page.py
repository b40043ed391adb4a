"""The objects of a memory as a page that needs nothing else, neither files nor network."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Sequence
from importlib import resources

from remind_jax.errors import printable
from remind_jax.printing.words import plural
from remind_jax.session.object_records import RememberedObject

_SLOT = re.compile(r"\{\{(\w+)\}\}")


def render_memory(objects: Sequence[RememberedObject], title: str, about: str) -> str:
    """The page as text.

    Args:
      objects: In the order shown.
      title: Heading.
      about: A sentence below it.
    """
    template = resources.files("remind_jax.session").joinpath("memory_page.html")
    slots = {
        "title": _escape(title),
        "about": _escape(about),
        "cards": "\n".join(map(_card, objects)),
    }
    return _SLOT.sub(lambda match: slots[match[1]], template.read_text(encoding="utf-8"))


def describe_sights(known: RememberedObject) -> str:
    """How often and when an object was seen."""
    first, last = known.first, known.last
    return (
        f"seen in {plural(known.num_frames, 'frame')}, first in session {first.session} "
        f"(frame {first.frame}), last in session {last.session} (frame {last.frame})"
    )


def _card(known: RememberedObject) -> str:
    views = "".join(
        f'<img alt="{_escape(known.title)}" src="data:image/jpeg;base64,'
        f'{base64.b64encode(jpeg).decode("ascii")}">'
        for jpeg in known.pictures
    )
    named = f"{known.label} {known.object_id}; " if known.name else ""
    merged = f"; with {', '.join(map(str, known.merged))}" if known.merged else ""
    return (
        f'<li><div class="views">{views or "<span>no picture</span>"}</div>'
        f"<h2>{_escape(known.title)}</h2>"
        f'<div class="faint">{_escape(named + describe_sights(known) + merged)}</div></li>'
    )


def _escape(text: str) -> str:
    return html.escape(printable(text))
