"""What a robot does, simulated or real: the contract, the loop, the sensors, the recording."""
