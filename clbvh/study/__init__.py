"""Figures of trees and of the report's experiments. Matplotlib, the extra `study`, is imported when one is drawn."""
