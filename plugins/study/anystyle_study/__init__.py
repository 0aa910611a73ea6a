"""User studies: designed, collected, analysed and drawn."""
