"""Frames of jobs that have several."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    time = sa.DateTime(timezone=True)
    op.create_table(
        "frames",
        sa.Column("job", sa.String(26), sa.ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True),
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("state", sa.String(20), nullable=False),
        sa.Column("progress", sa.JSON, nullable=False),
        sa.Column("reason", sa.Text),
        sa.Column("started", time, nullable=False),
        sa.Column("finished", time),
    )


def downgrade() -> None:
    op.drop_table("frames")
