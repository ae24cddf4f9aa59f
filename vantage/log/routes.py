"""Where messages go in a part: the channel of each topic and publisher, and the chunks it is written in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from schemas import TOPICS, Topic
from schemas.json_schema import json_schema
from vantage.log.compression import Compression
from vantage.log.metadata import REPEATED, VIEWER_PREFIX
from vantage.log.part import Part

if TYPE_CHECKING:
    from vantage.log.viewer import ViewerMessage

MOST_CHANNELS = 4096
"""Channels of one part; what strangers publish beyond them stands together on the channel `**` (MCAP counts to 65535)."""


def is_latched(topic: Topic) -> bool:
    """Return whether a topic's last message stays valid until the next: then every part of a log repeats it."""
    return topic.history > 0 and topic.rate == 0


class Route:
    """Where the messages of one (topic, publisher) go."""

    __slots__ = ("bulk_compression", "bulk_group", "channel", "compression", "latched")

    def __init__(self, channel: int, kind: str, compression: Compression, latched: bool) -> None:
        self.channel = channel
        self.compression = compression
        self.bulk_compression: Compression = "none" if compression == "none" else "lz4"
        self.bulk_group = kind
        self.latched = latched


class Routes:
    """The routes of one part; a channel is added to it when the first message wants it."""

    def __init__(self, part: Part, compression: Compression) -> None:
        self._part = part
        self._compression: Compression = compression
        self._routes: dict[tuple[str, str, bool], Route] = {}
        self._viewer_routes: dict[str, Route] = {}
        self._schemas: dict[str, int] = {}

    def of(self, key: str, publisher: str, well_formed: bool) -> Route:
        """Return the route of a message of the bus."""
        return self._routes.get((key, publisher, well_formed)) or self._add(key, publisher, well_formed)

    def repeated(self, key: str, publisher: str) -> Route:
        """Return a new route for what repeats the part before."""
        return self._new(key, publisher, {REPEATED: "true"})

    def of_viewer(self, message: ViewerMessage) -> Route:
        """Return the route of a translation for viewers."""
        route = self._viewer_routes.get(message.topic)
        if route is None:
            if message.schema_name not in self._schemas:
                self._schemas[message.schema_name] = self._part.add_schema(message.schema_name, "protobuf", message.schema)
            topic = VIEWER_PREFIX + message.topic
            channel = self._part.add_channel(topic, "protobuf", self._schemas[message.schema_name], {})
            route = self._viewer_routes[message.topic] = Route(channel, message.schema_name, self._compression, False)
        return route

    def _add(self, key: str, publisher: str, well_formed: bool) -> Route:
        topic = TOPICS.get(key)
        is_stranger = topic is None or publisher not in topic.publishers
        if is_stranger and len(self._routes) >= MOST_CHANNELS:
            key, publisher, well_formed = "**", "", False
            if (known := self._routes.get((key, publisher, well_formed))) is not None:
                return known
        if topic is None or not well_formed:
            channel = self._part.add_channel(key, "", 0, {"publisher": publisher})
            route = Route(channel, "unknown", self._compression, False)
        else:
            route = self._new(key, publisher, {})
        self._routes[key, publisher, well_formed] = route
        return route

    def _new(self, key: str, publisher: str, marks: dict[str, str]) -> Route:
        topic = TOPICS[key]
        kind = topic.type.__name__
        if kind not in self._schemas:
            self._schemas[kind] = self._part.add_schema(kind, "jsonschema", json_schema(topic.type))
        metadata = {"publisher": publisher, "delivery": topic.delivery, "rate": f"{topic.rate:g}"} | marks
        channel = self._part.add_channel(key, "msgpack", self._schemas[kind], metadata)
        return Route(channel, kind, self._compression, is_latched(topic))
