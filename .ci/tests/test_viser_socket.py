"""Internals of viser that the page stands on, in the installed release: one that misses a name is named."""

from __future__ import annotations

import inspect

import pytest
import viser
import viser._messages
import websockets.asyncio.server as ws
from viser.infra import _infra

from pipeline.system.errors import InputError
from spatialviz.app.viser_socket import OF_SCENE, TUNNELS, internal, scene_page, served_by


@pytest.mark.parametrize("name", [*OF_SCENE, *TUNNELS, "Message.deserialize"])
def test_the_installed_release_has_every_message(name: str) -> None:
    assert internal(f"_messages.{name}")


def test_the_page_of_its_client_takes_our_style() -> None:
    assert scene_page().count("</title>") == 1


def test_a_server_of_viser_is_started_where_ours_is_put_around_it() -> None:
    source = inspect.getsource(_infra)
    assert "websockets.asyncio.server" in source, "viser starts another server: served_by would not be asked"
    original = ws.serve
    with served_by(None):
        assert ws.serve is not original
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    assert ws.serve is original
    assert callable(internal("_websock_server.unregister_handler", server))
    server.stop()


def test_what_is_missing_is_named_with_the_release(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(viser._messages, "ViewerCameraMessage")
    with pytest.raises(InputError, match=rf"viser {viser.__version__} has no _messages\.ViewerCameraMessage"):
        internal("_messages.ViewerCameraMessage")
    with pytest.raises(InputError, match=r"has no ViserServer\._gone"):
        internal("_gone", object.__new__(viser.ViserServer))
