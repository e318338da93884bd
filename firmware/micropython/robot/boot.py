# Runs first after each reset, before main.py: nothing but what must come first belongs here.
#
# The pins need nothing: they float until main.py starts the controller, and pull-downs hold valves
# and motor off meanwhile (docs/hardware/pico.md). An empty file would do as well.
