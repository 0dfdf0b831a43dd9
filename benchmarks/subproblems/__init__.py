"""The certified test sets: `recipes` draws problems, `certify` proves their answers, `qpbenchmark` hands them on."""
