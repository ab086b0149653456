"""Keys for everything, and the page that lists them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import viser

from spatialviz.app.text import safe

KEYS: tuple[tuple[str, str, str], ...] = (
    ("R", "Ask again", "again"),
    ("J", "Next ranked pair", "next-pair:1"),
    ("K", "Previous ranked pair", "next-pair:-1"),
    ("N", "Next frame", "next-frame:1"),
    ("P", "Previous frame", "next-frame:-1"),
    ("T", "Next failure of the list", "next-failure:1"),
    ("I", "Previous failure of the list", "next-failure:-1"),
    ("1", "Camera: sensor", "camera:sensor"),
    ("2", "Camera: orbit", "camera:orbit"),
    ("3", "Camera: top", "camera:top"),
    ("F", "Look at the selected object", "focus"),
    ("C", "Next way to paint the cloud", "next-color"),
    ("V", "Show or hide the cloud", "flag:cloud"),
    ("B", "Show or hide other boxes", "flag:boxes"),
    ("L", "Show or hide names", "flag:labels"),
    ("O", "Show or hide pair lines", "flag:pairs"),
    ("G", "Show or hide exact boxes", "flag:truth"),
    ("Z", "Show or hide the labelled pair", "flag:ghosts"),
    ("Y", "Show or hide the viewer's axes at the reference", "flag:axes"),
    ("U", "Show or hide the room around the frame", "flag:context"),
    ("Shift+C", "Copy the view as a string", "copy-state"),
    ("Shift+V", "Open a view from its string", "paste-state"),
    ("Shift+K", "Save the answer as a case", "keep-case"),
    ("Shift+P", "Report of the answer as one page", "report"),
    ("Shift+U", "Say which surface is level: click it next", "level"),
    ("M", "Dark or light", "theme"),
    ("X", "Clear the question", "clear"),
    ("Shift+E", "Handles: move, turn, resize, off", "edit-mode:next"),
    ("Shift+H", "Hide the selected object, or show it again", "edit:hide"),
    ("Shift+R", "Show or hide the region of the asked relation", "flag:region"),
    ("Shift+F", "Show or hide the decision map", "edit-map"),
    ("Ctrl+Z", "Take the last edit back", "edit-undo"),
    ("0", "Take all edits back", "edit-reset"),
    ("Shift+M", "Correct the label that the verdict is by", "mend"),
    ("Shift+L", "Show the labels to correct them, or the answer again", "labels"),
    ("H", "List the keys (or ?)", "help"),
)

LABEL_KEYS: tuple[tuple[str, str, str], ...] = (
    ("T", "Label: true", "settle:T"),
    ("U", "Label: undecided", "settle:U"),
    ("F", "Label: false", "settle:F"),
    ("J", "Next item of the queue", "next-item:1"),
    ("K", "Previous item of the queue", "next-item:-1"),
    ("I", "Next relation of the pair", "next-row:1"),
    ("Y", "Accept the item, or the selected object", "accept-item"),
    ("Shift+Y", "Reject it", "reject-item"),
    ("Shift+U", "Unsure of it", "unsure-item"),
    ("Shift+G", "Retrain on the labels as they are", "retrain"),
    ("X", "The pair the other way round", "swap"),
    ("Shift+F", "Look at the selected object", "focus"),
    ("Shift+I", "Edit the pixels of the selected object", "px-tool:brush"),
    ("Shift+X", "Cut the selected object in parts", "px-tool:cut"),
    ("Shift+N", "New object, drawn on the picture", "px-new"),
    ("Shift+T", "New object, by clicks in the scene", "px-new:scene"),
    ("Shift+M", "Merge the selected object into the one before", "px-merge"),
    ("Alt+J", "Next expression", "next-expression:1"),
    ("Alt+I", "Edit the expression's text", "edit-text"),
    ("Alt+T", "The expression is true of the selected object, or not", "true-of:sure"),
    ("Alt+U", "The expression may be true of the selected object, or not", "true-of:likely"),
    ("Alt+B", "Several objects are an acceptable answer, or one", "ambiguous"),
    ("Alt+M", "Mark the expression: label wrong, box wrong, neither", "mark:next"),
    ("Alt+Y", "Accept the expression", "expression-status:accepted"),
    ("Alt+N", "Reject the expression", "expression-status:rejected"),
    ("Ctrl+Z", "Undo", "take-back"),
    ("Ctrl+Y", "Redo", "bring-back"),
    ("Shift+O", "Name the class of the object", "class-focus"),
    ("Shift+J", "Fit the box to its points", "box-fit"),
    ("Shift+B", "Extend the box to what the object stands on", "box-snap:extend"),
    ("Shift+Z", "Set the box down on what the object stands on", "box-snap:move"),
)
"""What keys mean while labels are shown; all others mean the same as ever."""

KEYS_OF_ONE = "Of one object, or a sentence: Y accepts, Shift+Y rejects, Shift+U is unsure"

LAYER_KEYS: tuple[tuple[str, str, str], ...] = (
    ("Shift+B", "Boxes of both detectors, of the own, of the second", "layer:next"),
    ("Shift+J", "Next disagreement of the two detectors", "next-disagreement:1"),
    ("Shift+O", "Previous disagreement of the two detectors", "next-disagreement:-1"),
)
"""The keys where a second detector stands beside the own one."""

MOVE_KEYS: tuple[tuple[str, str, str], ...] = (
    ("7", "Turn left", "move:rotate_ccw"),
    ("8", "Step forward", "move:forward"),
    ("9", "Turn right", "move:rotate_cw"),
    ("4", "Step to the left", "move:left"),
    ("5", "Step back", "move:backward"),
    ("6", "Step to the right", "move:right"),
)
"""The keys of datasets with moves: two rows of a number pad, and the rows of the buttons."""


MODIFIERS = {"": None, "Shift": "shift", "Ctrl": "cmd/ctrl", "Alt": "alt"}


def keys_of(moving: bool, beside: bool = False) -> tuple[tuple[str, str, str], ...]:
    """(key, what it does, message) of every key; those of moves and of a second detector only where there are any."""
    return (*KEYS, *(LAYER_KEYS if beside else ()), *(MOVE_KEYS if moving else ()))


def meant(message: str, correcting: bool) -> str:
    """The message of a key that was pressed ("key:T"), which depends on whether labels are shown; others unchanged."""
    kind, _, pressed = message.partition(":")
    if kind != "key":
        return message
    rows = (*LABEL_KEYS, *KEYS, *MOVE_KEYS) if correcting else (*KEYS, *LAYER_KEYS, *MOVE_KEYS)
    return next((m for key, _, m in rows if key == pressed), "")


def _pressed(key: str) -> str:
    return " ".join(f"<kbd>{safe(part)}</kbd>" for part in key.split("+"))


def help_html(moving: bool, correcting: bool, beside: bool = False, labelling: bool = False) -> str:
    """The keys as a list; with `correcting` those of labels beside, which come first while labels are shown."""
    taken = {key for key, _, _ in LABEL_KEYS} if labelling else set[str]()
    general = [("/", "Type a question"), *((k, label) for k, label, _ in keys_of(moving, beside) if k not in taken)]
    lists = [_keys_html("", [*general, ("Ctrl+K", "Find any command")])]
    if correcting:
        lists.append(_keys_html("While labels are shown", [(k, label) for k, label, _ in LABEL_KEYS]))
    beside_each_other = " two" if correcting else ""
    return f'<div class="sv keylists{beside_each_other}">{"".join(lists[::-1] if labelling else lists)}</div>'


def _keys_html(title: str, rows: Sequence[tuple[str, str]]) -> str:
    head = f'<b class="sec">{title}</b>' if title else ""
    cells = "".join(f"<span>{_pressed(key)}</span><span>{safe(label)}</span>" for key, label in rows)
    return f'<div class="keys">{head}{cells}</div>'


def add_keys(
    client: viser.ClientHandle, post: Callable[[str], None], moving: bool, correcting: bool, beside: bool = False
) -> None:
    """Register every key as a command of this client; with `correcting`, those of labels, too."""
    labels = {key: label for key, label, _ in LABEL_KEYS} if correcting else {}
    rows = {key: label for key, label, _ in keys_of(moving, beside)}
    for key in {**rows, **labels}:
        said = rows[key] if key not in labels else f"{rows[key]} | {labels[key]}" if key in rows else labels[key]
        held, _, pressed = key.rpartition("+")
        hotkey: Any = pressed
        modifier: Any = MODIFIERS[held]
        command = client.gui.add_command(said, hotkey=hotkey, modifier=modifier)

        def trigger(event: Any, key: str = key) -> None:
            post(f"key:{key}")

        command.on_trigger(trigger)


class HelpDialog:
    """The list of keys as a dialog; the key that opens it closes it, as Escape does."""

    def __init__(
        self,
        client: viser.ClientHandle,
        post: Callable[[str], None],
        moving: bool,
        correcting: bool,
        beside: bool = False,
        labelling: Callable[[], bool] = lambda: False,
    ) -> None:
        self._client = client
        self._html = lambda: help_html(moving, correcting, beside, labelling())
        self._post = post
        self._modal: Any = None

    def toggle(self) -> None:
        """Show it, or hide it where it is shown."""
        if self._modal is not None:
            self.close()
            return
        self._modal = self._client.gui.add_modal("Keys")
        with self._modal:
            self._client.gui.add_html(self._html())
            button = self._client.gui.add_button("Close")

        @button.on_click
        async def _(event: viser.GuiEvent) -> None:
            self._post("close-help")

    def close(self) -> None:
        """Hide it."""
        if self._modal is not None:
            self._modal.close()
            self._modal = None
