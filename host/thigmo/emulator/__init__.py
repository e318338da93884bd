"""The emulated robot and room, behind the URLs `emulator://`, `mega-sim://`, `micropython://`.

Programs reach a robot through the link and never imports this package; the tests do.
"""
