"""Objects, instances and parts with their names, as values; saved scenes. Knows nothing of trees and pictures."""
