"""Dataset readers: the protocol, optional capabilities, and names of frames.

Moves between frames, expressions of its own, splits, frames without annotations: a dataset has one of these where it
has the method of that name; the functions here ask for it, and give nothing for a dataset without it.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any, Protocol, overload

import numpy as np

from pipeline.datasets.settings import Settings
from pipeline.geometry.frame import Frame
from pipeline.system.errors import InputError, require
from pipeline.system.frozen import dataclass


class Dataset(Protocol):
    """A folder of frames, opened but not yet read.

    A dataset may have more to say, by methods that `pipeline.datasets.base`
    asks for and that most do not have: `moves(frame_id)`, a dict of move to frame id;
    `given_expressions(frame_id)`, a tuple of GivenExpression; `splits()`, a dict of
    split to frame ids; `scene_of(frame_id)`, the name of its scene or None;
    `load_picture(frame_id)`, the frame without its annotations; `notes`, a tuple of
    what no file states and the reader takes for granted.

    Attributes
    ----------
    root : Path
        The folder that was opened. Nothing outside it is read, except the camera file of a Redwood recording or a
        room of Replica (and its trajectory, where `results/` was opened), and the camera file and instance names of
        an AVD scan, which may stand one folder up.
    format : str
        Name of the on-disk format: "bop", "7-scenes", "scannet", "tum", "sunrgbd", "sunrgbd-votenet", "redwood",
        "avd", "semantic-abstraction", "case" (a saved one), "ycb-video", "apc", "arkitscenes", "nerfstudio",
        "colmap", "replica", "stray-scanner", "polycam", "scannet++", "record3d", "parquet", "robospatial", "ros",
        "folder", "pictures", or a plugin's.
    frame_ids : tuple of str
        Every frame the dataset lists, broken ones too, in order.
    class_names : tuple of str
        The annotated classes, known without decoding an image; empty where none.

    Examples
    --------
    >>> from pipeline.datasets import InMemoryDataset, demo_path, open_dataset
    >>> frame = open_dataset(demo_path()).load("000001/000000")
    >>> InMemoryDataset([frame]).load(frame.id).depth.shape
    (480, 640)
    """

    @property
    def root(self) -> Path: ...

    @property
    def format(self) -> str: ...

    @property
    def frame_ids(self) -> tuple[str, ...]: ...

    @property
    def class_names(self) -> tuple[str, ...]: ...

    def load(self, frame_id: str) -> Frame:
        """Decode a frame.

        Raises
        ------
        InputError
            The id is unknown, or the frame is broken: the file and the reason.
        """
        ...


@dataclass(frozen=True)
class DatasetFormat:
    """An on-disk format: recognition and opening.

    Attributes
    ----------
    signature : str
        One line that says what is looked for in the folder.
    recognises : callable
        Whether a folder is of this format. Must be fast and must not raise.
    open : callable
        Opens a folder; what `Settings` gives wins over what the files say.

    Examples
    --------
    >>> from pathlib import Path
    >>> from pipeline.datasets import DatasetFormat, InMemoryDataset
    >>> form = DatasetFormat("lab", "lab: index.lab", lambda root: (root / "index.lab").is_file(), InMemoryDataset)
    >>> form.recognises(Path("nowhere"))
    False
    """

    name: str
    signature: str
    recognises: Callable[[Path], bool]
    open: Callable[[Path, Settings], Dataset]


def resolve_frame(dataset: Dataset, key: str | int) -> str:
    """Resolve a frame id or index to a frame id of the dataset; see `named_frame`.

    Examples
    --------
    >>> from pipeline.datasets import demo_path, open_dataset, resolve_frame
    >>> demo = open_dataset(demo_path())
    >>> resolve_frame(demo, 0), resolve_frame(demo, "1/2")
    ('000001/000000', '000001/000002')
    """
    return named_frame(dataset.frame_ids, key, dataset.root)


def named_frame(ids: Sequence[str], key: str | int, root: Path) -> str:
    """Resolve a frame id or index among all ids in order; `root` is the folder for the error.

    An exact id comes first, then an index counted from 0, then the same path
    with its numbers written differently ("1/20" for "000001/000020").
    """
    text = str(key).strip()
    if isinstance(key, str) and text in ids:
        return text
    if re.fullmatch(r"[0-9]{1,15}", text) and not isinstance(key, bool):
        if int(text) < len(ids):
            found = ids[int(text)]
            # Nobody writes an index with leading zeros; a scene may be named without.
            others = [i for i in ids if f"/{text}/" in f"/{i}" or (text != f"{int(text)}" and i.endswith(f"/{text}"))]
            scene = sorted(others, key=lambda i: not i.startswith(f"{text}/"))
            listed = ", ".join(scene[:3]) + (f" and {len(scene) - 3} more" if len(scene) > 3 else "")
            require(
                not isinstance(key, str) or not set(others) - {found},
                f"{text!r} names more than one frame",
                got=f"the index {int(text)}, which is {found}, and a part of {listed}",
                expected="a whole id" + (f", or {int(text)} for the index" if text != f"{int(text)}" else ""),
                path=root,
            )
            return found
    elif "/" in text:
        same = [frame_id for frame_id in ids if _loose(frame_id) == _loose(text)]
        if len(same) == 1:
            return same[0]
    raise unknown_id(ids, text, root)


def scene_of(dataset: Dataset, frame_id: str) -> str:
    """Scene of a frame: by the dataset, else the folder part of the id, else the dataset's name."""
    known = getattr(dataset, "scene_of", None)
    if callable(known) and (own := known(frame_id)) is not None:
        return str(own)
    parent = str(PurePosixPath(frame_id).parent)
    return dataset.root.resolve().name if parent in (".", "/") else parent


def scenes_of(dataset: Dataset) -> tuple[str, ...]:
    """Scene of every frame, as by `scene_of`; frames of a folder share its name."""
    own, known = callable(getattr(dataset, "scene_of", None)), dict[str, str]()
    folders = dataset.frame_ids if own else [frame_id.rpartition("/")[0] for frame_id in dataset.frame_ids]
    for folder, frame_id in zip(folders, dataset.frame_ids, strict=True):
        if folder not in known:
            known[folder] = scene_of(dataset, frame_id)
    return tuple(known[folder] for folder in folders)


def frames_of_scene(dataset: Dataset, frame_id: str) -> tuple[str, ...]:
    """Frame ids of the same scene, in the dataset's order."""
    folder = PurePosixPath(frame_id).parent
    return tuple(other for other in dataset.frame_ids if PurePosixPath(other).parent == folder)


def unknown_id(ids: Sequence[str], key: str, root: Path) -> InputError:
    """Error for an id not among `ids`, with the nearest ids and the count."""
    near = difflib.get_close_matches(key, ids[:20_000], n=3, cutoff=0.3) or list(ids[:3])
    return InputError(
        f"no frame {key[:80]!r} among {len(ids)}",
        expected=f"an id or an index from 0 to {len(ids) - 1}" if ids else None,
        cause=f"nearest ids: {', '.join(near)}" if near else None,
        path=root,
    )


def _loose(frame_id: str) -> str:
    return re.sub(r"0*([0-9]+)", r"\1", frame_id).lower()


MOVES = ("rotate_ccw", "rotate_cw", "forward", "backward", "left", "right")
"""The moves of a robot from one frame to another, in the order in which they are always given:
turning left and right (seen from above, counter-clockwise is to the left), then stepping."""


@dataclass(frozen=True)
class GivenExpression:
    """A referring expression from the dataset's own files.

    Attributes
    ----------
    text : str
        As the dataset says it: "mug on the left of a laptop".
    target, reference : str
        Class names.
    relation : str
        One of ours: "left", "right", "front", "behind", "on", "in".
    target_indices, reference_indices : tuple of int
        Every annotation (its `index`) that is meant; empty where none of them can be seen in the frame.
    """

    text: str
    target: str
    relation: str
    reference: str
    target_indices: tuple[int, ...] = ()
    reference_indices: tuple[int, ...] = ()


def has_moves(dataset: Dataset) -> bool:
    """Test whether the dataset has moves between frames."""
    return callable(getattr(dataset, "moves", None))


def moves(dataset: Dataset, frame_id: str) -> dict[str, str]:
    """Frame ids by possible move, in the order of `MOVES`.

    Raises
    ------
    InputError
        The dataset has moves, and no such frame.
    """
    found: dict[str, str] = _ask(dataset, "moves", {}, frame_id)
    return {move: found[move] for move in MOVES if move in found}


def given_expressions(dataset: Dataset, frame_id: str) -> tuple[GivenExpression, ...]:
    """Referring expressions of the dataset about a frame; empty without any.

    Raises
    ------
    InputError
        The dataset gives expressions, and no such frame, or its file is broken.
    """
    return _ask(dataset, "given_expressions", (), frame_id)


def splits(dataset: Dataset) -> dict[str, tuple[str, ...]]:
    """The frames of each of the dataset's own splits by the split's name; empty for a dataset without any.

    Raises
    ------
    InputError
        A split file that cannot be read, or must not be.
    """
    return _ask(dataset, "splits", {})


def dataset_notes(dataset: Dataset) -> tuple[str, ...]:
    """Assumptions for every frame without a file behind them: a unit or a camera known from the format, with the option
    to change each."""
    return getattr(dataset, "notes", ())


def load_pose(dataset: Dataset, frame_id: str) -> np.ndarray | None:
    """Pose T_world_camera (4, 4) of a frame, or None; without decoding where possible."""
    method: Any = getattr(dataset, "load_pose", None)
    return load_picture(dataset, frame_id).camera.T_world_camera if method is None else method(frame_id)


def load_depth(dataset: Dataset, frame_id: str) -> np.ndarray | None:
    """Measured depth (H, W) float32, metres, of a frame as its camera saw it, or None; without colour where possible.

    It is 0 where missing, and NaN where it was measured in a unit that nothing tells.
    """
    method: Any = getattr(dataset, "load_depth", None)
    if method is not None:
        return method(frame_id)
    frame = load_picture(dataset, frame_id)
    return None if frame.depth_source else frame.depth


def load_picture(dataset: Dataset, frame_id: str) -> Frame:
    """Load a frame without annotations where the dataset can leave them out, else whole."""
    method: Any = getattr(dataset, "load_picture", None)
    return dataset.load(frame_id) if method is None else method(frame_id)


def readable_frames(load: Callable[[str], Frame], ids: Iterable[str]) -> Iterator[Frame]:
    """Load the readable frames of these ids; broken frames are skipped."""
    for frame_id in ids:
        with suppress(InputError):
            yield load(frame_id)


def _ask(dataset: Dataset, capability: str, nothing: Any, *arguments: str) -> Any:
    method = getattr(dataset, capability, None)
    return method(*arguments) if callable(method) else nothing


class Frames(Sequence[Frame]):
    """Sequence of all frames of a dataset, decoded on access and not kept. `frames[0]`, `frames["000001/000000"]` (the
    keys of `resolve_frame`), `frames[-3:]`, `len(frames)`, and a loop. A broken frame raises InputError."""

    def __init__(self, dataset: Dataset, ids: tuple[str, ...] | None = None) -> None:
        self._dataset = dataset
        self.ids = dataset.frame_ids if ids is None else ids

    def __len__(self) -> int:
        return len(self.ids)

    @overload
    def __getitem__(self, key: int | str) -> Frame: ...
    @overload
    def __getitem__(self, key: slice) -> Frames: ...
    def __getitem__(self, key: int | str | slice) -> Frame | Frames:
        if isinstance(key, slice):
            return Frames(self._dataset, self.ids[key])
        # A sequence ends with an IndexError, which `resolve_frame` does not know.
        return self._dataset.load(resolve_frame(self._dataset, key) if isinstance(key, str) else self.ids[key])

    def __repr__(self) -> str:
        return f"<Frames {len(self)} of {self._dataset.root}>"


class ChangedFrames:
    """A dataset with frames changed on loading."""

    def __init__(self, inner: Dataset) -> None:
        self.inner = inner
        self.root, self.format, self.frame_ids = inner.root, inner.format, inner.frame_ids

    @property
    def class_names(self) -> tuple[str, ...]:
        return self.inner.class_names

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "inner":
            raise AttributeError(name)
        found = getattr(self.inner, name)
        if name == "load_picture":
            return lambda frame_id: self.changed(found(frame_id))
        return found

    def changed(self, frame: Frame) -> Frame:
        """Change a frame of the inner dataset (subclasses); InputError where impossible."""
        raise NotImplementedError

    def load(self, frame_id: str) -> Frame:
        """Decode a frame; see `Dataset.load`."""
        return self.changed(self.inner.load(frame_id))


class InMemoryDataset:
    """Frames in memory as a dataset (`pipeline.datasets.base.Dataset`).

    Parameters
    ----------
    frames : iterable of Frame
        At least one; their ids differ.

    Raises
    ------
    InputError
        No frame, or two of one id.
    """

    format = "memory"
    root = Path("memory")

    def __init__(self, frames: Iterable[Frame]) -> None:
        frames = tuple(frames)
        self._frames = {frame.id: frame for frame in frames}
        require(
            frames and len(self._frames) >= len(frames),
            "frames of a dataset have ids of their own",
            got=", ".join(f.id for f in frames[:6]) or "no frame",
        )
        self.frame_ids = tuple(self._frames)
        self.class_names = tuple(sorted({a.label for f in frames for a in f.annotations}))

    def __repr__(self) -> str:
        return f"<InMemoryDataset of {len(self.frame_ids)} frames>"

    def load(self, frame_id: str) -> Frame:
        """The frame; see `Dataset.load`."""
        if frame_id not in self._frames:
            raise unknown_id(self.frame_ids, frame_id, self.root)
        return self._frames[frame_id]
