"""The LFT type, its algebra, reduction and bound, and the model around it: numpy and scipy only."""
