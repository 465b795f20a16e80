"""The average reward per step: gain and bias of chains and policies, and the best of both."""
