"""force_torque."""
