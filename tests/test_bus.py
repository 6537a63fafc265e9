"""The observer bus: order, an observer that raises, a disk that is full."""

from __future__ import annotations

import pytest

from dssmsg.errors import StorageError
from dssmsg.events import ErrorOccurred, PhaseStarted
from dssmsg.mission.bus import ObserverBus


class Keeper:
    def __init__(self):
        self.events, self.closed = [], 0

    def on_event(self, event):
        self.events.append(event)

    def close(self):
        self.closed += 1

    def outputs(self):
        return {"kept": str(len(self.events))}


class Raising(Keeper):
    def __init__(self, error):
        super().__init__()
        self.error = error

    def on_event(self, event):
        raise self.error


PHASE = PhaseStarted("survey", 0, 0, 0.0)


def test_all_are_told_in_order():
    first, second = Keeper(), Keeper()
    bus = ObserverBus([("a", first), ("b", second)])
    later = PhaseStarted("revisit", 1, 5, 1.0)
    bus.tell(PHASE)
    bus.tell(later)
    assert first.events == second.events == [PHASE, later]


def test_one_that_raises_is_disabled_and_recorded_through_the_others():
    keeper, raising = Keeper(), Raising(RuntimeError("boom"))
    bus = ObserverBus([("bad", raising), ("good", keeper)])
    bus.tell(PHASE)
    bus.tell(PHASE)
    errors = [event for event in keeper.events if isinstance(event, ErrorOccurred)]
    assert len(errors) == 1
    assert errors[0].plugin == "observer/bad"
    assert "boom" in errors[0].message
    assert [event for event in keeper.events if event is PHASE] == [PHASE, PHASE]
    assert bus.failed == ["bad"]
    assert bus.errors == 1
    assert bus.outputs() == {"kept": "3"}


def test_a_full_disk_is_not_survived():
    keeper = Keeper()
    bus = ObserverBus([("disk", Raising(StorageError("full"))), ("good", keeper)])
    with pytest.raises(StorageError):
        bus.tell(PHASE)


def test_close_closes_all_and_then_says_what_failed():
    class Unclosable(Keeper):
        def close(self):
            raise StorageError("flush failed")

    keeper = Keeper()
    bus = ObserverBus([("disk", Unclosable()), ("good", keeper)])
    with pytest.raises(StorageError, match="flush failed"):
        bus.close()
    assert keeper.closed == 1


def test_one_whose_warning_reaches_the_others_is_told_once():
    """The bus logs a failure; where logs are events, that may not go round in circles."""
    from dssmsg.mission.log_events import logged_as_events

    keeper = Keeper()
    bus = ObserverBus([("bad", Raising(RuntimeError("boom"))), ("good", keeper)])
    with logged_as_events(bus.tell, lambda: (3, 0.6)):
        bus.tell(PHASE)
    kinds = [type(event).__name__ for event in keeper.events]
    assert sorted(kinds) == ["ErrorOccurred", "Logged", "PhaseStarted"]


def test_outputs_that_fail_do_not_lose_the_others():
    class Mute(Keeper):
        def outputs(self):
            raise RuntimeError("no")

    bus = ObserverBus([("mute", Mute()), ("good", Keeper())])
    assert bus.outputs() == {"kept": "0"}
    assert bus.failed == ["mute"]
