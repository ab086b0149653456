"""Keyboard shortcuts, their list, and the search for a command."""

from __future__ import annotations

from collections.abc import Mapping

from spatialviz.app.channel import Command
from spatialviz.app.context import Context, Part, command
from spatialviz.app.markup import Element, h

Rows = tuple[tuple[str, str, str], ...]
"""(key, what it does, message); a key without a message is the browser's own."""

KEYS: Mapping[str, Rows] = {
    "Asking": (
        ("/", "Type a question", ""),
        ("R", "Ask again", "again"),
        ("X", "Clear the question", "clear"),
        ("Ctrl+K", "Find any command", "help"),
        ("H", "List the keys (or ?)", "help"),
    ),
    "Moving through": (
        ("J", "Next ranked pair", "next-pair:1"),
        ("K", "Previous ranked pair", "next-pair:-1"),
        ("N", "Next frame", "next-frame:1"),
        ("P", "Previous frame", "next-frame:-1"),
        ("Shift+W", "All frames as pictures", "frame-grid"),
        (".", "Next failure of the list", "next-failure:1"),
        (",", "Previous failure of the list", "next-failure:-1"),
    ),
    "Looking": (
        ("Shift+A", "Look at the pair", "camera:pair"),
        ("1", "Look from the camera", "camera:sensor"),
        ("2", "Look from above", "camera:top"),
        ("F", "Look at the selected object", "focus"),
        ("C", "Next way to paint the cloud", "next-color"),
        ("V", "Show or hide the cloud", "flag:cloud"),
        ("Shift+V", "Dim the points beside the answer, or none", "flag:dim"),
        ("B", "Show or hide other boxes", "flag:boxes"),
        ("L", "Show or hide names", "flag:labels"),
        ("O", "Show or hide pair lines", "flag:pairs"),
        ("G", "Show or hide the dataset's own boxes", "flag:truth"),
        ("Z", "Show or hide the labelled pair", "flag:ghosts"),
        ("Y", "Show or hide the viewer's axes at the reference", "flag:axes"),
        ("U", "Show or hide the room around the frame", "flag:context"),
        ("Shift+R", "Show or hide the region of the asked relation", "flag:region"),
        ("Shift+U", "Say which surface is level: click it next", "pick:level"),
        ("Shift+D", "Measure: click two surfaces", "pick:measure"),
        ("Shift+S", "Show or hide the metre grid on the floor", "flag:grid"),
        ("-", "Smaller points", "point-size:less"),
        ("=", "Larger points", "point-size:more"),
        ("Escape", "Stop measuring, close the drawer, the scene large again", "pick:"),
        ("M", "Dark or light", "theme"),
    ),
    "Keeping": (
        ("Ctrl+C", "Copy the address of this view, where no text is selected", ""),
        ("Shift+C", "Copy the answer as a picture", "copy-picture"),
        ("Shift+G", "Film of the answer before and after what would mend it", "copy-film"),
        ("Shift+K", "Save the answer as a case", "keep-case"),
        ("Shift+P", "Report of the answer as one page", "report"),
    ),
    "Editing": (
        ("Shift+E", "Handles: move, turn, resize, off", "edit-mode:next"),
        ("Shift+H", "Hide the selected object, or show it again", "edit:hide"),
        ("Ctrl+Z", "Take the last edit back", "edit-undo"),
        ("0", "Take all edits back", "edit-reset"),
        ("Shift+M", "Correct the label that the verdict is by", "mend"),
        ("Shift+L", "Show the labels to correct them, or the answer again", "labels"),
    ),
}

LABEL_KEYS: Mapping[str, Rows] = {
    "Answers": (
        ("Y", "Correct", "decide:right"),
        ("N", "Wrong", "decide:wrong"),
        ("U", "Unsure", "decide:unsure"),
        ("T", "Label the relation true", "settle:T"),
        ("F", "Label the relation false", "settle:F"),
        ("Shift+Y", "Wrong", "decide:wrong"),
        ("Shift+U", "Leave it to somebody else", "unsure-item"),
        ("I", "Next relation of the pair", "next-row:1"),
        ("X", "The pair the other way round", "swap"),
        ("J", "Next item of the queue", "next-item:1"),
        ("K", "Previous item of the queue", "next-item:-1"),
    ),
    "Objects": (
        (".", "Next object (Tab in the side views)", "next-object:1"),
        (",", "Previous object (Shift+Tab in the side views)", "next-object:-1"),
        *((str(k), f"Class {k} of the row of classes", f"digit:{k}") for k in range(1, 10)),
        ("Shift+F", "Look at the selected object", "focus"),
        ("Shift+T", "The same object in the next frame", "same-object:1"),
        ("Shift+Z", "The same object in the frame before", "same-object:-1"),
        ("Shift+O", "Name the class of the object", "class-focus"),
        ("Shift+J", "Fit the box to its points", "box-fit"),
    ),
    "Pixels": (
        ("Shift+I", "Edit the pixels of the selected object", "px-tool:brush"),
        ("Shift+X", "Cut the selected object in parts", "px-tool:cut"),
        ("Shift+N", "New object, drawn on the picture", "px-new"),
        ("Shift+W", "New object, painted on the picture", "px-new:brush"),
        ("Shift+Q", "New object, by clicks in the picture's depth", "px-new:depth"),
        ("Shift+M", "Merge the selected object into the one before", "px-merge"),
    ),
    "Sentences": (
        ("Alt+J", "Next expression", "next-expression:1"),
        ("Alt+I", "Edit the expression's text", "edit-text"),
        ("Alt+T", "The expression is true of the selected object, or not", "true-of:sure"),
        ("Alt+U", "The expression may be true of the selected object, or not", "true-of:likely"),
        ("Alt+B", "Several objects are an acceptable answer, or one", "ambiguous"),
        ("Alt+M", "Mark the expression: label wrong, box wrong, neither", "mark:next"),
        ("Alt+Y", "The expression is correct", "expression-status:accepted"),
        ("Alt+N", "The expression is wrong", "expression-status:rejected"),
    ),
    "Frames": (
        ("]", "Next frame", "next-frame:1"),
        ("[", "Previous frame", "next-frame:-1"),
        ("P", "Previous frame", "next-frame:-1"),
    ),
    "History": (
        ("Ctrl+Z", "Undo", "take-back"),
        ("Ctrl+Y", "Redo", "bring-back"),
        ("Shift+G", "Retrain on the labels as they are", "retrain"),
    ),
}
"""Keys with another meaning while labels are shown."""

MOVE_KEYS: Rows = (
    ("7", "Turn left", "move:rotate_ccw"),
    ("8", "Step forward", "move:forward"),
    ("9", "Turn right", "move:rotate_cw"),
    ("4", "Step to the left", "move:left"),
    ("5", "Step back", "move:backward"),
    ("6", "Step to the right", "move:right"),
)
"""Keys of datasets with moves: two rows of a number pad, and the rows of buttons."""

MOUSE: Mapping[str, Rows] = {
    "The list of Evaluate": (
        ("/", "Search", ""),
        ("J", "Next row (K: the one before; arrows, Home, End, Page Up and Down in the list)", ""),
        ("Enter", "Explain the row", ""),
        ("X", "Select the row, or no more (Space, Ctrl+Click)", ""),
        ("Shift+Arrows", "Select from row to row (Shift+Click)", ""),
        ("Ctrl+A", "Select all that the search finds", ""),
        ("Escape", "Select nothing", ""),
    ),
    "Mouse and keys in the scene": (
        ("Drag", "Turn the view", ""),
        ("Right drag", "Move the view", ""),
        ("Wheel", "Nearer, or farther", ""),
        ("Click", "Select the object", ""),
        ("W A S D Q E", "Move the camera", ""),
        ("Arrows", "Turn the view", ""),
    ),
    "Mouse in the picture": (
        ("Click", "Select the object", ""),
        ("Shift+Drag", "A rectangle: the pixels of the selected object, or while labels are shown a new one", ""),
    ),
}

TITLE = "Keys and commands"


def keys_of(labelling: bool, moving: bool = True) -> dict[str, Rows]:
    """Keys by purpose, moves only for datasets of moves; keys of shown labels come first, and replace others."""
    own = LABEL_KEYS if labelling else {}
    taken = {key for rows in own.values() for key, _, _ in rows}
    always = {**KEYS, "Moves": MOVE_KEYS if moving else ()}
    return {**own, **{group: tuple(r for r in rows if r[0] not in taken) for group, rows in always.items()}}


def meant(message: Command, correcting: bool) -> Command:
    """Command of a pressed key, depending on `correcting`; other commands unchanged."""
    if message.name != "key":
        return message
    rows = (row for group in keys_of(correcting).values() for row in group)
    return next((Command.read(text) for key, _, text in rows if (key,) == message.arguments), Command(""))


class Keys(Part):
    """Keyboard of a client: the page listens for keys and sends "key:T"; a dialog lists them."""

    def __init__(self, ctx: Context) -> None:
        super().__init__(ctx)
        every = (*self._keys(False).values(), *(LABEL_KEYS.values() if ctx.shared.journals else ()))
        ctx.page.call("keys", list(dict.fromkeys(key for rows in every for key, _, message in rows if message)))

    def _keys(self, labelling: bool) -> dict[str, Rows]:
        return keys_of(labelling, self.ctx.shared.moving)

    @command("help")
    def toggle(self) -> None:
        """Show or hide every command, searchable by name or key."""
        if self.ctx.dialog.title == TITLE:
            self.ctx.dialog.close()
        else:
            self.ctx.dialog.show(TITLE, keys_html(self._keys(self.state.labels is not None)))

    @command("close-dialog")
    def close(self) -> None:
        self.ctx.dialog.close()

    @command("run")
    def run(self, key: str) -> None:
        """Execute the command of a key."""
        self.ctx.dialog.close()
        self.ctx.handle(Command("key", (key,)))


def keys_html(groups: Mapping[str, Rows]) -> Element:
    """Search field, every command with its key, filtered by the typed text, and the gestures of the mouse."""
    field = h.input(
        cls="find",
        field="commands",
        autofocus=True,
        spellcheck="false",
        autocomplete="off",
        placeholder="a command or its key",
        aria_label="Command or key",
    )
    commands = (
        h.button(h.span(label), _pressed(key), role="option", aria_selected="false", tabindex="-1", do=f"run:{key}")
        for rows in groups.values()
        for key, label, message in rows
        if message
    )
    gestures = (
        h.section(h.h3(group), h.dl(((h.dt(_pressed(key)), h.dd(label)) for key, label, _ in rows), cls="keys"))
        for group, rows in MOUSE.items()
    )
    listed = h.div(commands, cls="commands", role="listbox", aria_label="Commands", tabindex=0)
    return h.div(field, listed, h.div(gestures, cls="gestures"), cls="keylists")


def _pressed(key: str) -> Element:
    return h.span(h.kbd(part) for part in key.split("+"))
