import sys

from spatialviz.cli import main

if __name__ == "__main__":
    sys.exit(main())
