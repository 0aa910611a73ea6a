"""User studies: designed, collected, analysed and drawn. Nothing here needs torch."""
