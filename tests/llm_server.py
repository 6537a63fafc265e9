"""A server on 127.0.0.1 that speaks the OpenAI and the Anthropic protocols, and misbehaves as it is told.

    with LlmServer(prose, good) as server: ...      # the first request gets prose, all others a good answer

A behaviour is a function of the request that answers through `Exchange`; what was asked is in `server.asked`.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

SINK = {
    "kind": "explicit",
    "nodes": [{"label": "sink", "attributes": []}],
    "edges": [],
    "core": 0,
}
ANTHROPIC = "/v1/messages"


@dataclass(frozen=True)
class Asked:
    """A request as it came in."""

    path: str
    headers: Mapping[str, str]
    body: Mapping[str, Any]

    @property
    def structured(self) -> bool:
        return "response_format" in self.body or "output_config" in self.body

    @property
    def key(self) -> str:
        return self.headers.get("x-api-key") or self.headers.get("authorization", "").removeprefix("Bearer ")

    @property
    def texts(self) -> str:
        return json.dumps(self.body, ensure_ascii=False)


class Exchange:
    """One request and the ways to answer it."""

    def __init__(self, asked: Asked, handler: BaseHTTPRequestHandler, stopping: threading.Event) -> None:
        self.asked = asked
        self.stopping = stopping
        self._handler = handler

    def completion(self, text: str, end: str | None = None) -> bytes:
        """A good body of the protocol that was asked, with `text` as the model's answer."""
        if self.asked.path == ANTHROPIC:
            body: Any = {
                "id": "msg_1",
                "type": "message",
                "role": "assistant",
                "model": self.asked.body["model"],
                "content": [{"type": "text", "text": text}],
                "stop_reason": end or "end_turn",
                "stop_sequence": None,
                "usage": {"input_tokens": 40, "output_tokens": 2},
            }
        else:
            message = {"role": "assistant", "content": text}
            body = {
                "id": "chatcmpl-1",
                "object": "chat.completion",
                "created": 1,
                "model": self.asked.body["model"],
                "choices": [{"index": 0, "message": message, "finish_reason": end or "stop"}],
                "usage": {"prompt_tokens": 40, "completion_tokens": 2, "total_tokens": 42},
            }
        return json.dumps(body).encode()

    def send(
        self,
        body: bytes,
        status: int = 200,
        kind: str = "application/json",
        headers: Mapping[str, str] | None = None,
        length: int | None = None,
    ) -> None:
        """Answer; `length` is the promised length where it is not the real one."""
        handler = self._handler
        handler.send_response(status)
        for name, value in {"Content-Type": kind, "Connection": "close", **(headers or {})}.items():
            handler.send_header(name, value)
        handler.send_header("Content-Length", str(len(body) if length is None else length))
        handler.end_headers()
        handler.wfile.write(body)

    def say(self, text: str, end: str | None = None, headers: Mapping[str, str] | None = None) -> None:
        """A good response with `text` as the model's answer."""
        self.send(self.completion(text, end), headers=headers)

    def refuse(self, status: int, message: str, headers: Mapping[str, str] | None = None) -> None:
        """An error as both protocols spell it."""
        error = {"type": "some_error", "message": message, "code": None, "param": None}
        self.send(json.dumps({"type": "error", "error": error}).encode(), status, headers=headers)

    def drip(self, body: bytes, pause: float) -> None:
        """A good response, a byte at a time: no silence is ever long."""
        handler = self._handler
        handler.send_response(200)
        handler.send_header("Content-Type", "application/json")
        handler.send_header("Content-Length", str(len(body)))
        handler.end_headers()
        for place in range(len(body)):
            if self.stopping.wait(pause):
                return
            handler.wfile.write(body[place : place + 1])
            handler.wfile.flush()


Behaviour = Callable[[Exchange], None]


def good(exchange: Exchange) -> None:
    exchange.say(json.dumps(SINK))


def saying(text: str, end: str | None = None) -> Behaviour:
    return lambda exchange: exchange.say(text, end)


def refusing(status: int, message: str = "no", **headers: str) -> Behaviour:
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return lambda exchange: exchange.refuse(status, message, named)


def silent(exchange: Exchange) -> None:
    """Takes the request and says nothing."""
    exchange.stopping.wait(20)


def dripping(exchange: Exchange) -> None:
    exchange.drip(exchange.completion(json.dumps(SINK)), 0.02)


def hanging_up(exchange: Exchange) -> None:
    """Closes the connection without a word."""


prose = saying("Sure! You will find the sink in the bathroom, next to the mirror.")
broken_json = saying('{"kind": "explicit", "nodes": [{"label": "sink"')
wrong_schema = saying(json.dumps({**SINK, "kind": "maybe", "confidence": 1}))
unknown_nodes = saying(json.dumps({**SINK, "edges": [{"source": 0, "target": 7, "relation": "on"}]}))
thousand_nodes = saying(json.dumps({**SINK, "nodes": [{"label": "sink", "attributes": []}] * 1000}))


def huge(exchange: Exchange) -> None:
    """A body of 3 MB."""
    exchange.say(json.dumps({**SINK, "padding": "x" * 3_000_000}))


def cut(exchange: Exchange) -> None:
    """Promises the whole body and ends in its middle."""
    body = exchange.completion(json.dumps(SINK))
    exchange.send(body[: len(body) // 2], length=len(body))


def wrong_type(exchange: Exchange) -> None:
    exchange.send(b"<html><body>Welcome to the hotel's WLAN</body></html>", kind="text/html")


def telling_the_key(exchange: Exchange) -> None:
    """An error that repeats the key, as some servers do."""
    exchange.refuse(
        401, f"Incorrect API key provided: {exchange.asked.key}. Header: {exchange.asked.headers}"
    )


def answering_with_the_key(exchange: Exchange) -> None:
    key = exchange.asked.key
    exchange.say(json.dumps({**SINK, "nodes": [{"label": f"sink {key}", "attributes": [key]}]}))


class LlmServer:
    """Runs while inside the `with`; the n-th behaviour answers the n-th request, the last all others."""

    def __init__(self, *behaviours: Behaviour) -> None:
        self.behaviours = behaviours
        self.asked: list[Asked] = []
        self._stopping = threading.Event()
        self._lock = threading.Lock()
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                headers = {name.lower(): value for name, value in self.headers.items()}
                outer._answer(Asked(self.path, headers, json.loads(body)), self)
                self.close_connection = True

            def log_message(self, *arguments: Any) -> None:
                pass

        class Server(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *arguments: Any) -> None:
                """A client that goes away while it is answered is what is tested."""

        self._server = Server(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self._server.server_port}"

    def base_url(self, protocol: str) -> str:
        """What the provider of a protocol takes as `base_url`."""
        return self.address if protocol == "anthropic" else f"{self.address}/v1"

    def _answer(self, asked: Asked, handler: BaseHTTPRequestHandler) -> None:
        with self._lock:
            behaviour = self.behaviours[min(len(self.asked), len(self.behaviours) - 1)]
            self.asked.append(asked)
        behaviour(Exchange(asked, handler, self._stopping))

    def __enter__(self) -> LlmServer:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stopping.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
