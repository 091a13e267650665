"""What a window manager sends a window whose cross is clicked, and at Alt+F4: the message WM_DELETE_WINDOW."""

import ctypes
import ctypes.util

_CLIENT_MESSAGE = 33


class _ClientMessage(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_int),
        ("serial", ctypes.c_ulong),
        ("send_event", ctypes.c_int),
        ("display", ctypes.c_void_p),
        ("window", ctypes.c_ulong),
        ("message_type", ctypes.c_ulong),
        ("format", ctypes.c_int),
        ("data", ctypes.c_long * 5),
    ]


class _Event(ctypes.Union):
    _fields_ = [("message", _ClientMessage), ("room", ctypes.c_long * 24)]


def ask_to_close(display: str, window: int) -> None:
    """Ask the window with this number, on a screen by name, to close."""
    lib = ctypes.CDLL(ctypes.util.find_library("X11") or "libX11.so.6")
    lib.XOpenDisplay.restype = ctypes.c_void_p
    lib.XInternAtom.restype = ctypes.c_ulong
    lib.XInternAtom.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int]
    lib.XSendEvent.argtypes = [
        *(ctypes.c_void_p, ctypes.c_ulong, ctypes.c_int, ctypes.c_long),
        ctypes.POINTER(_Event),
    ]
    lib.XCloseDisplay.argtypes = [ctypes.c_void_p]
    connection = lib.XOpenDisplay(display.encode())
    assert connection, f"{display} does not answer"
    protocols, delete = (
        lib.XInternAtom(connection, name, 0) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW")
    )
    event = _Event()
    event.message = _ClientMessage(
        _CLIENT_MESSAGE, 0, 1, connection, window, protocols, 32, (delete, 0, 0, 0, 0)
    )
    assert lib.XSendEvent(connection, window, 0, 0, ctypes.byref(event))
    lib.XCloseDisplay(connection)
