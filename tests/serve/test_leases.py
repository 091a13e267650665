"""Leases: who is in, and who is out by idling or by being gone."""

import pytest

session = pytest.importorskip("accelsurf.serve.session")


class Clock:
    def __init__(self):
        self.now = 1000.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


def test_a_person_who_does_nothing_loses_the_place_in_spite_of_heartbeats(clock):
    leases = session.Leases(1, 100.0, clock)
    token = leases.claim()
    for _ in range(3):
        clock.now += 30
        leases.find(token)
    assert leases.remaining(token) == 10.0
    leases.find(token, by_person=True)
    assert leases.remaining(token) == 100.0
    for _ in range(3):
        clock.now += 50
        if clock.now < 1000 + 90 + 101:
            leases.find(token)
    with pytest.raises(session.LeaseLostError):
        leases.find(token)


def test_a_client_that_is_gone_loses_the_place_after_a_minute(clock):
    leases = session.Leases(1, 1e6, clock)
    token = leases.claim()
    clock.now += session.LIVENESS
    with pytest.raises(session.FullError):
        leases.claim()
    clock.now += 1
    assert leases.claim() != token
    with pytest.raises(session.LeaseLostError):
        leases.remaining(token)


def test_a_place_that_is_given_back_is_free_at_once(clock):
    leases = session.Leases(2, 100.0, clock)
    first, second = leases.claim(), leases.claim()
    leases.release(first)
    leases.release("another")
    assert leases.claim() not in (first, second)
    assert leases.find(second).session is None
