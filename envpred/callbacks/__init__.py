"""What happens beside a run of Lightning's: pictures, and what is written of forecasts."""
