"""`python -m paper_repro.agents`."""

from exact_mdp.paper_repro.agents.cli import main

if __name__ == "__main__":
    main(prog_name="python -m paper_repro.agents")
