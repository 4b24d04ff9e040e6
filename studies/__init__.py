"""Monte-Carlo studies that compare calibration methods: ``python -m studies`` lists them."""
