"""The first three joints of any geometry: where they bring a point (Pieper's regional structure)."""
