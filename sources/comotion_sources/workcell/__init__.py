"""The simulated workcell: MuJoCo scenes whose RGB-D cameras are rendered on the CPU, with truth."""
