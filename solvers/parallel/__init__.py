"""Many pieces of work: on all cores, on a cluster, resumable, by the same code everywhere."""
