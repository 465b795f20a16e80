"""The two agents of Yuan et al. (2025), Sections 2.2, 3.1 and 3.3: a person and a caregiver.

The scenario's Markov model drives a person's status. A language model, or the scripted stand-in
for one, puts the status into behaviour, reads a status back out of the behaviour, and puts the
chosen assistance into words. This is a simulator for research on decision models; it is not
medical advice, and no person took part in its texts.
"""

DISCLAIMER = (
    "Simulated conversation for research on decision models. Not medical advice. "
    "No real person took part."
)
