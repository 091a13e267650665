"""Command queue: order, waiting, and what happens to commands that nobody carries out."""

import threading

import pytest

from accelsurf.viewer.core.command_queue import CommandQueue


def test_commands_come_out_in_order_and_then_it_is_closed():
    commands = CommandQueue()
    works = [lambda: 1, lambda: 2]
    for work in works:
        commands.put(work)
    commands.close()
    assert commands.pending == 2 and not commands.is_closed
    taken = [commands.next(block=True) for _ in works]
    assert [command.work for command in taken] == works
    assert commands.next(block=True) is None and commands.is_closed
    for _ in taken:
        commands.done()
    assert commands.pending == 0


def test_without_blocking_an_empty_queue_gives_nothing():
    commands = CommandQueue()
    assert commands.next(block=False) is None and commands.is_empty and not commands.is_closed


def test_waiting_ends_when_the_condition_is_true_and_was_notified():
    commands = CommandQueue()
    future = commands.put(lambda: "done")

    def carry_out():
        command = commands.next(block=True)
        command.future.set_result(command.work())
        commands.done()
        commands.notify()

    assert not commands.wait_for(lambda: commands.pending == 0, 0.01)
    thread = threading.Thread(target=carry_out)
    thread.start()
    assert commands.wait_for(lambda: commands.pending == 0, 10) and future.result(0) == "done"
    thread.join()


def test_abandoned_commands_are_cancelled():
    commands = CommandQueue()
    futures = [commands.put(lambda: None) for _ in range(3)]
    commands.wake()
    commands.abandon()
    assert all(future.cancelled() for future in futures)
    assert (
        commands.pending == 0
        and commands.is_empty
        and commands.wait_for(lambda: commands.pending == 0, 0)
    )


@pytest.mark.parametrize("wake", [CommandQueue.wake, CommandQueue.close])
def test_a_waiting_thread_can_be_woken(wake):
    commands, woken = CommandQueue(), threading.Event()

    def wait():
        assert commands.next(block=True) is None
        woken.set()

    thread = threading.Thread(target=wait)
    thread.start()
    wake(commands)
    assert woken.wait(10)
    thread.join()
