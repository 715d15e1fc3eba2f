"""Which service holds a job, and quotas of keys; lists by state, and by age of what has ended, that read no requests."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "requests",
        sa.Column("job", sa.String(26), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("text", sa.Text, nullable=False),
    )
    op.execute("INSERT INTO requests (job, text) SELECT id, request FROM jobs")
    op.drop_column("jobs", "request")
    op.add_column("jobs", sa.Column("holder", sa.String(26)))
    op.add_column("jobs", sa.Column("heartbeat", sa.DateTime(timezone=True)))
    op.create_index("jobs_by_state", "jobs", ["state", "id"])
    op.create_index("jobs_by_end", "jobs", ["finished"])
    op.add_column("api_keys", sa.Column("quota_seconds", sa.Float))
    op.add_column("api_keys", sa.Column("used_seconds", sa.Float, nullable=False, server_default="0"))


def downgrade() -> None:
    op.drop_column("api_keys", "used_seconds")
    op.drop_column("api_keys", "quota_seconds")
    op.drop_index("jobs_by_end", "jobs")
    op.drop_index("jobs_by_state", "jobs")
    op.drop_column("jobs", "heartbeat")
    op.drop_column("jobs", "holder")
    op.add_column("jobs", sa.Column("request", sa.Text, nullable=False, server_default=""))
    op.execute("UPDATE jobs SET request = (SELECT text FROM requests WHERE requests.job = jobs.id)")
    op.drop_table("requests")
