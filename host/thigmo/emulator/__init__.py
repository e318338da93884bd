"""The emulated robot and room, behind the URLs `emulator://`, `mega-sim://`, `micropython://`.

Whoever uses a robot reaches it through the link and never imports this package; the tests do.
"""
