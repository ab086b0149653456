"""Pictures and films of an answer: into the clipboard, or where it is closed into a file."""

import base64
import io

import numpy as np
from browser import OpenTab, Tab
from PIL import Image
from servers import Server

SIZE = 1200, 630
READ = """async () => {
  const [item] = await navigator.clipboard.read();
  const bytes = new Uint8Array(await (await item.getType('image/png')).arrayBuffer());
  return btoa(bytes.reduce((text, byte) => text + String.fromCharCode(byte), ''));
}"""


def saved(tab: Tab, key: str) -> tuple[str, Image.Image]:
    """Name and picture of the file that a key saves."""
    with tab.page.expect_download() as found:
        tab.press(key)
    with open(found.value.path(), "rb") as file:
        return found.value.suggested_filename, Image.open(io.BytesIO(file.read()))


def test_the_answer_is_copied_as_a_picture(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address, "absent", permissions=["clipboard-read", "clipboard-write"])
    tab.press("Shift+C")
    tab.see("#toasts", "the picture of this answer")
    picture = Image.open(io.BytesIO(base64.b64decode(tab.page.evaluate(READ))))
    assert picture.size == SIZE
    assert np.asarray(picture.convert("RGB")).std() > 20


def test_where_the_clipboard_is_closed_it_is_saved(demo: Server, open_tab: OpenTab) -> None:
    tab = open_tab(demo.address, "absent")
    tab.page.evaluate("Object.defineProperty(navigator, 'clipboard', {value: undefined})")
    name, picture = saved(tab, "Shift+C")
    assert name.endswith(".png")
    assert (picture.format, picture.size) == ("PNG", SIZE)
    tab.see("#toasts", "the browser keeps the clipboard closed here")
    name, film = saved(tab, "Shift+G")
    assert name.endswith(".gif")
    assert (film.format, film.size, film.n_frames) == ("GIF", SIZE, 2)  # pyright: ignore[reportAttributeAccessIssue]
