"""Kinds of saved policies, the entry points `outrider.policies`."""

from bus.policies import PolicyKind

NPZ = PolicyKind(form="FILE.npz", uav="outrider_learning.networks:load_npz_policy")
ONNX = PolicyKind(form="FILE.onnx", ugv="outrider_learning.ugv_policies:load_onnx")
SB3 = PolicyKind(
    form="ALGORITHM:FILE.zip",
    ugv="outrider_learning.ugv_policies:load_sb3",
    uav="outrider_learning.saved:load_sb3_policy",
)
TORCH = PolicyKind(form="FILE.pt", ugv="outrider_learning.ugv_policies:load_torch")
