"""`vantage foxglove`: a running deployment, live in Foxglove or Lichtblick.

A listener on the bus like `vantage status`, and a Foxglove WebSocket server fed by the translation that logs get, too. It says
nothing on the bus, and nothing of it waits for a viewer: each has a bounded queue, of which the oldest message goes.
"""

from __future__ import annotations

import ipaddress
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import foxglove
import tyro
from rich.console import Console

from schemas import TOPICS
from services.recorder.appearance import arena_appearance
from vantage.bus import Bus, Lost, Sample
from vantage.deployment import Deployment
from vantage.errors import UserError
from vantage.log.foxglove_layout import SUFFIX, as_json, layout_of
from vantage.log.metadata import VIEWER_PREFIX
from vantage.log.viewer import Viewer, ViewerMessage

console = Console(highlight=False)

BACKLOG = 256
"""Messages that wait for one viewer before the oldest is dropped."""
_MOST_WISHES = 1024
_LIVE_TOPICS = (
    *(f"{robot}/{part}" for robot in ("hider", "seeker") for part in ("pose", "color", "depth", "view", "calibration")),
    *("scene", "frames", "hider/plan/values", "hider/plan/picture", "hider/plan/path", "predictor/views", "text"),
)


@dataclass(frozen=True)
class LiveViewer:
    """Show a running deployment in Foxglove or Lichtblick, until Ctrl-C.

    Examples:
        vantage foxglove
        vantage foxglove --deployment rehearsal --port 9000
    """

    deployment: str = "simulation"
    """A configuration of compose/, up."""
    folder: Path | None = None
    """Private runtime folder, as given to `vantage up`."""
    arena: str = "table"
    """Name of the arena on the bus."""
    host: str = "127.0.0.1"
    """Address to listen on. Anybody who reaches it can watch: the protocol knows no passwords."""
    port: Annotated[int, tyro.conf.arg(metavar="PORT")] = 8765
    """Port to listen on; 0: any free one."""


class LiveViewerError(UserError):
    """Why there is no live view, and what to do, for people."""


@dataclass(frozen=True, slots=True)
class Subscribed:
    """A viewer wants a channel: it is sent the last message of it, or it would see nothing until the next."""

    client: int
    topic: str


class Server:
    """The Foxglove server: takes bus messages, translates what somebody looks at, and sends it.

    Attributes:
        port: it listens on.
    """

    def __init__(self, host: str, port: int, on_subscribe: Callable[[Subscribed], None], name: str = "vantage") -> None:
        """Start listening.

        Args:
            on_subscribe: called from the server's threads; hand what it gets to `send_last` on the thread that calls `take`.

        Raises:
            LiveViewerError: the address is taken or cannot be listened on.
        """
        self._viewer = Viewer(arena_appearance())
        self._context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._keys: dict[str, set[str]] = {}
        self._last: dict[str, bytes] = {}
        self._listener = _Listener(on_subscribe)
        try:
            self._server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                context=self._context,
                server_listener=self._listener,
                message_backlog_size=BACKLOG,
            )
        except Exception as error:
            raise LiveViewerError(
                f"cannot listen on {host}:{port} ({error}): choose another --port, or 0 for a free one"
            ) from None
        self.port: int = self._server.port

    def take(self, sample: Sample) -> None:
        """Show a message of the bus to those who look at its channels."""
        topic = TOPICS.get(sample.key)
        if topic is None:
            return
        payload = sample.payload
        self._last[sample.key] = payload
        known = self._keys.get(sample.key)
        if known and not _lacking(sample.key, known) and not any(self._channels[name].has_sinks() for name in known):
            return
        for message in self._viewer.translate(sample.key, payload):
            self._keys.setdefault(sample.key, set()).add(message.topic)
            self._channel(message).log(message.payload, log_time=sample.published)

    def send_last(self, wish: Subscribed) -> None:
        """Send one viewer the last message of a channel, translated by a viewer that has not seen anything yet."""
        self._listener.waiting.discard(wish)
        fresh = Viewer(arena_appearance())
        for key, topics in self._keys.items():
            if wish.topic not in {VIEWER_PREFIX + name for name in topics}:
                continue
            for message in fresh.translate(key, self._last[key]):
                if VIEWER_PREFIX + message.topic == wish.topic:
                    self._channel(message).log(message.payload, sink_id=wish.client)

    def stop(self) -> None:
        """Let everybody go. Waits at most two seconds."""
        stopper = threading.Thread(target=self._stop, daemon=True)
        stopper.start()
        stopper.join(2.0)

    def _stop(self) -> None:
        self._server.stop()

    def _channel(self, message: ViewerMessage) -> Any:
        channel = self._channels.get(message.topic)
        if channel is None:
            schema = foxglove.Schema(name=message.schema_name, encoding="protobuf", data=message.schema)
            channel = foxglove.Channel(
                VIEWER_PREFIX + message.topic, schema=schema, message_encoding="protobuf", context=self._context
            )
            self._channels[message.topic] = channel
        return channel


def _lacking(key: str, known: set[str]) -> bool:
    """Whether a key may bring topics that it has not brought yet: a plan without a value map hides nothing of the next one's."""
    return any(name.startswith(f"{key}/") and name not in known for name in _LIVE_TOPICS)


class _Listener(foxglove.ServerListener):
    """Passes on who subscribes to what; each wish once, and not more than `_MOST_WISHES` at a time."""

    def __init__(self, tell: Callable[[Subscribed], None]) -> None:
        self.waiting: set[Subscribed] = set()
        self._tell = tell

    def on_subscribe(self, client: Any, channel: Any) -> None:
        wish = Subscribed(client.id, channel.topic)
        if wish not in self.waiting and len(self.waiting) < _MOST_WISHES:
            self.waiting.add(wish)
            self._tell(wish)


def serve(bus: Bus, server: Server, is_over: Callable[[], bool]) -> int:
    """Show what the bus says until it is over. Returns how many messages were lost on the way here."""
    lost = 0
    while not is_over():
        event = bus.receive(0.2)
        if isinstance(event, Sample):
            server.take(event)
        elif isinstance(event, Subscribed):
            server.send_last(event)
        elif isinstance(event, Lost):
            lost += event.missed
    return lost


def main(settings: LiveViewer) -> int:
    """Serve until Ctrl-C.

    Raises:
        DeploymentError: the deployment is not up.
        LiveViewerError: the address cannot be listened on.
    """
    deployment = Deployment(settings.deployment, settings.folder)
    deployment.processes()
    # Zenoh is imported late: other commands of `vantage` must not wait for it.
    from vantage.bus.zenoh_bus import ZenohBus

    over = threading.Event()
    before = {number: signal.signal(number, lambda *_: over.set()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with ZenohBus(f"foxglove-{os.getpid()}", deployment.folder, settings.arena) as bus:
            server = Server(settings.host, settings.port, bus.post, f"vantage {settings.deployment}")
            try:
                layout = deployment.folder / f"foxglove{SUFFIX}"
                layout.write_text(as_json(layout_of([VIEWER_PREFIX + topic for topic in _LIVE_TOPICS], arena_appearance())))
                _say(settings, server.port, layout)
                # Raw: of what this process is too slow for, a bounded number of bytes waits.
                bus.subscribe("**", raw=True)
                lost = serve(bus, server, over.is_set)
            finally:
                server.stop()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    console.print(f"closed; {lost} messages came too fast to be shown" if lost else "closed")
    return 0


def _say(settings: LiveViewer, port: int, layout: Path) -> None:
    address = f"ws://{settings.host}:{port}"
    console.print(f"{settings.deployment} is shown at [bold]{address}[/bold]", soft_wrap=True)
    console.print(f"  in Foxglove or Lichtblick: Open connection, Foxglove WebSocket, {address}", soft_wrap=True)
    console.print(f"  then import the layout {layout}", soft_wrap=True)
    if not _is_loopback(settings.host):
        console.print("  [yellow]anybody who reaches this address can watch[/yellow]")
    console.print("Ctrl-C ends it")


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
