"""The doctor: what is wrong with a dataset, a run or this machine, before it costs a training."""
