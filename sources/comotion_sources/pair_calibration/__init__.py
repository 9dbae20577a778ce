"""The extrinsics of two cameras that observe one target."""
