"""Pressures below which a muscle does nothing."""

from __future__ import annotations

from thigmo.link.protocol import PARAMETERS

# Below, it bends the body by less than a sensor's noise: by 4e-4 1/cm with the default map.
UNBENT_CPSI = 10
UNBENT_PSI = UNBENT_CPSI / 100
# Below, it is vented, as the board has it if nobody has set another limit.
VENTED_CPSI = PARAMETERS["vent_cpsi"].defaults[0]
VENTED_PSI = VENTED_CPSI / 100
