"""A bad network: forwards datagrams between addresses, with delay, jitter and loss in both directions.

``python relay.py SPEC`` with a JSON list of ``{"listen": [host, port], "target": [host, port]}`` and the
options ``delay_s``, ``jitter_s``, ``loss`` prints ``ready`` and runs until it is killed.
"""

import asyncio
import json
import random
import sys
from typing import Any

Address = tuple[str, int]


class Weather:
    """When a datagram arrives, if it does."""

    def __init__(self, delay_s: float, jitter_s: float, loss: float) -> None:
        self._delay_s, self._jitter_s, self._loss = delay_s, jitter_s, loss
        self._rng = random.Random(7)

    def carry(self, deliver: Any, *arguments: Any) -> None:
        if self._rng.random() < self._loss:
            return
        delay = self._delay_s + self._rng.uniform(-self._jitter_s, self._jitter_s)
        asyncio.get_running_loop().call_later(delay, deliver, *arguments)


class Back(asyncio.DatagramProtocol):
    """The way back to one client."""

    def __init__(self, weather: Weather, front: asyncio.DatagramTransport, client: Address) -> None:
        self._weather, self._front, self._client = weather, front, client

    def datagram_received(self, data: bytes, _: Address) -> None:
        self._weather.carry(self._front.sendto, data, self._client)

    def error_received(self, _: Exception) -> None:
        """The other side is not there; the sender will try again."""


class Front(asyncio.DatagramProtocol):
    """Where the clients of one link connect to."""

    def __init__(self, weather: Weather, target: Address) -> None:
        self._weather, self._target = weather, target
        self._transport: Any = None
        self._ways: dict[Address, asyncio.Task[Any]] = {}

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, client: Address) -> None:
        if client not in self._ways:
            loop = asyncio.get_running_loop()
            made = loop.create_datagram_endpoint(
                lambda: Back(self._weather, self._transport, client), remote_addr=self._target
            )
            self._ways[client] = loop.create_task(made)
        self._ways[client].add_done_callback(
            lambda task: self._weather.carry(task.result()[0].sendto, data) if not task.exception() else None
        )

    def error_received(self, _: Exception) -> None:
        """A client has gone."""


async def main(spec: dict[str, Any]) -> None:
    weather = Weather(spec["delay_s"], spec["jitter_s"], spec["loss"])
    loop = asyncio.get_running_loop()
    for link in spec["links"]:
        target = tuple(link["target"])
        await loop.create_datagram_endpoint(
            lambda target=target: Front(weather, target), local_addr=tuple(link["listen"])
        )
    print("ready", flush=True)
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(main(json.loads(sys.argv[1])))
