"""Is a learned policy right? Its regret, where it errs, and why."""
