"""``python -m simfoundry`` is the command line."""

from simfoundry.cli.main import main

if __name__ == "__main__":
    main()
