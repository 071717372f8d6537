"""First value of every key that a later version added; older stored files lack the key."""

from typing import Any

FIRST_VALUES: dict[str, dict[str, Any]] = {
    "scene": {
        "contact_damping": 1.0,
        "contact_impedance": 0.95,
        "deep_impedance": 0.99,
        "slip_time_s": None,
    },
    "control": {"goal": "step", "smoothing_s": 0.0, "goal_delay_s": 0.0},
    "wrist": {
        "force_bias_n": 0.0,
        "torque_bias_nm": 0.0,
        "force_drift_nps": 0.0,
        "torque_drift_nmps": 0.0,
        "gain_error": 0.0,
        "cross_talk": 0.0,
    },
    "pose": {
        "position_noise_m": 0.0,
        "orientation_noise_rad": 0.0,
        "linear_noise_mps": 0.0,
        "angular_noise_radps": 0.0,
        "position_offset_m": 0.0,
        "height_offset_m": 0.0,
        "rotation_offset_rad": 0.0,
    },
    "filter": {"gate": 0.0, "correlation": 0.0, "match_temperature": 1.0},
    "sensor": {"noise": "peg", "contact_features": False, "pose": "world", "places": 0},
    "train": {
        "epochs": 5000,
        "batch_size": 128,
        "learning_rate": 1e-4,
        "schedule": "constant",
        "weight_decay": 0.0,
        "mirror": False,
        "baseline_share": 1.0,
    },
}
"""By section and key; a key that is not listed still has its first default, or was always stored."""
