"""What tests of several rooms share: waiting, ports, threads, isolation, fixtures and peers."""
