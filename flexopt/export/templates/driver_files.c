{# The two files of a driver's call. #}
  if (argc < 3) {
    fputs("{{ driver }} INPUTS OUTPUTS\n", stderr);
    return 2;
  }
  source = fopen(argv[1], "rb");
  sink = fopen(argv[2], "wb");
  if ((source == NULL) || (sink == NULL)) {
    fputs("{{ driver }}: a file cannot be opened\n", stderr);
    return 2;
  }
