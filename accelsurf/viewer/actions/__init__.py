"""Actions of a person on a scene and a session; window and page share them."""
