"""The panel of pages: figures, buttons, the choice of colours, and plots of probes."""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from taichi_sim.viewer.player import COMMANDS, Command, Player, Rows
from taichi_sim.viewer.web_server import WebServer
from taichi_sim.viewer.web_stage import COLOURS

__all__ = ["History", "WebPanel"]

REFRESH = 0.25  # s between figures, and between plots
MOST_POINTS = 1000  # of a plot
MOST_SERIES = 8  # of a plot
TINTS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#8c564b", "#7f7f7f")
BUTTONS = 3  # in a row
KEYS = {"space": "space", "right arrow": "arrowright"}  # of those that viser knows, the ones that are no letters
STYLE = (
    "<style>.figures{margin:.4em 1em;font-size:.9em}.figures td:first-child{color:#888;padding-right:1em}"
    ".figures td{font-variant-numeric:tabular-nums}</style>"
)


class History:
    """The values of probes so far, at most MOST_POINTS of them, evenly spread: every second one goes where there are more."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = names
        self.begin()

    def begin(self) -> None:
        """Forget all."""
        self._rows: list[list[float]] = []
        self._every, self._seen, self._last = 1, 0, -np.inf

    def add(self, time: float, values: Mapping[str, float]) -> None:
        """Take note of a moment [s]. One that is earlier than the last begins anew."""
        if time == self._last:
            return
        if time < self._last:
            self.begin()
        self._last = time
        if self._seen % self._every == 0:
            self._rows.append([time, *(values.get(name, np.nan) for name in self.names)])
        self._seen += 1
        if len(self._rows) > MOST_POINTS:
            self._rows, self._every = self._rows[::2], 2 * self._every

    def columns(self, names: Sequence[str]) -> tuple[NDArray[np.float64], ...]:
        """Times, and the values of each of these probes."""
        rows = np.array(self._rows).reshape(-1, 1 + len(self.names))
        return tuple(rows[:, [0, *(1 + self.names.index(name) for name in names)]].T.copy())


class WebPanel:
    """The panel of all pages of a server.

    title: the heading; player: whose commands are buttons and keys, None: there are none; probes: the unit of each, by its name;
    colour: which of COLOURS is chosen at first.
    """

    def __init__(
        self, server: WebServer, title: str, probes: Mapping[str, str], colour: str, player: Player | None = None
    ) -> None:
        self.server, self.gui, self.colour = server, server.viser.gui, colour
        self.gui.set_panel_label(title)
        self._figures = self.gui.add_html("")
        self._player, self._rows = player, list[tuple[Any, Sequence[Command]]]()
        if player is not None:
            for first in range(0, len(COMMANDS), BUTTONS):
                self._buttons(player, COMMANDS[first : first + BUTTONS])
        choice = self.gui.add_dropdown("Colour", COLOURS, initial_value=colour)
        choice.on_update(self._choose)
        self.history = History(list(probes))
        self._plots = [(names, self._plot(names, unit)) for unit, names in _by_unit(probes)]
        self._due = 0.0
        self._shown: Any = None

    def _buttons(self, player: Player, commands: Sequence[Command]) -> None:
        """A row of buttons, and the keys that do the same."""
        acts = {label: one.act for one in commands for label in (one.label, one.paused) if label}
        row = self.gui.add_button_group("", tuple(one.label for one in commands))
        self._rows.append((row, commands))

        # functions of asyncio are called one after the other, and others in any order
        async def press(event: Any) -> None:
            if event.target.value in acts:
                self.server.later(partial(acts[event.target.value], player))

        row.on_click(press)
        for one in commands:
            key = one.key.upper() if len(one.key) == 1 and one.key.isalpha() else KEYS.get(one.key)
            command = self.gui.add_command(one.label, description=one.words, hotkey=key)
            command.on_trigger(partial(self._trigger, partial(one.act, player)))

    async def _trigger(self, act: Callable[[], None], _: Any) -> None:
        self.server.later(act)

    async def _choose(self, event: Any) -> None:
        if event.target.value in COLOURS:
            self.server.later(partial(setattr, self, "colour", event.target.value))

    def _plot(self, names: Sequence[str], unit: str) -> Any:
        series = [{"label": f"{name} [{unit}]" if unit else name, "stroke": tint} for name, tint in zip(names, TINTS)]
        empty = tuple(np.zeros(0) for _ in range(1 + len(names)))
        return self.gui.add_uplot(
            empty, ({"label": "t [s]"}, *series), scales={"x": {"time": False}}, legend={"live": False}, height=180
        )

    def show(self, time_: float, probes: Mapping[str, float], rows: Callable[[], Rows], last: bool = False) -> None:
        """Show figures and what probes say at a moment [s]; both a few times a second at most, but always those of the last."""
        self.history.add(time_, probes)
        if time.perf_counter() < self._due and not last:
            return
        self._due = time.perf_counter() + REFRESH
        said = rows()
        if said == self._shown:
            return
        self._shown = said
        if self._player is not None:
            for row, commands in self._rows:
                labels = tuple((self._player.paused and one.paused) or one.label for one in commands)
                if labels != row.options:
                    row.options = labels
        cells = "".join(f"<tr><td>{escape(name)}</td><td>{escape(text)}</td></tr>" for name, text in said)
        self._figures.content = f"{STYLE}<table class='figures'>{cells}</table>"
        for names, plot in self._plots:
            plot.data = self.history.columns(names)


def _by_unit(probes: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Names of probes with the same unit together, MOST_SERIES at most."""
    found = dict[str, list[str]]()
    for name, unit in probes.items():
        found.setdefault(unit, []).append(name)
    return [
        (unit, names[k : k + MOST_SERIES]) for unit, names in found.items() for k in range(0, len(names), MOST_SERIES)
    ]
