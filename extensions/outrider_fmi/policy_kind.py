"""FMI units as policies, the entry point `outrider.policies`."""

from bus.policies import PolicyKind

FMU = PolicyKind(form="FILE.fmu", ugv="outrider_fmi.driver:FmuPolicy")
