"""Many spin rates and parameter values: jobs, storage that resumes, Dask. No ROS needed."""
