"""The step of any method as compiled programs: packed, kept between processes, prepared ahead."""
